// SPDX-License-Identifier: Apache-2.0
// Interface between the command line parser and the commands. A command is a function
// that adds a subcommand and its options to the parser. If the user chooses the command,
// a callback stores the function to run in `call.run`. To add a command, write a new file
// and add one line here and one word in main.cpp.
#pragma once

#include <functional>
#include <string>

#include <relidar/base/error.hpp>

namespace CLI {
class App;
}

namespace relidar::cli {

struct ParsedCommand {
    std::string command_line;   ///< Command line as the user typed it. Reports show this text.
    std::function<void()> run;  ///< Runs the chosen command. Throws an exception if the command fails.
};

void add_list_devices(CLI::App& list_command, ParsedCommand& call);
void add_list_sensors(CLI::App& list_command, ParsedCommand& call);
void add_list(CLI::App& app, ParsedCommand& call);
void add_convert(CLI::App& app, ParsedCommand& call);
void add_info(CLI::App& app, ParsedCommand& call);
void add_train(CLI::App& app, ParsedCommand& call);
void add_refine(CLI::App& app, ParsedCommand& call);
void add_serve(CLI::App& app, ParsedCommand& call);
void add_edit(CLI::App& app, ParsedCommand& call);
void add_assets(CLI::App& app, ParsedCommand& call);
void add_render(CLI::App& app, ParsedCommand& call);
void add_eval(CLI::App& app, ParsedCommand& call);
void add_export(CLI::App& app, ParsedCommand& call);
void add_demo(CLI::App& app, ParsedCommand& call);
void add_view(CLI::App& app, ParsedCommand& call);
void add_check(CLI::App& app, ParsedCommand& call);

}  // namespace relidar::cli
