// SPDX-License-Identifier: Apache-2.0
// Interface between the command line parser and the commands. A command is a function
// that adds a subcommand and its options to the parser. If the user chooses the command,
// a callback stores the function to run in `call.run`. To add a command, write a new file
// and add one line here and one line in commands.cpp.
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

void add_commands(CLI::App& app, ParsedCommand& selected_command);

void add_list_devices_command(CLI::App& list_command, ParsedCommand& selected_command);
void add_list_sensors_command(CLI::App& list_command, ParsedCommand& selected_command);
void add_list_settings_command(CLI::App& list_command, ParsedCommand& selected_command);
void add_list_command(CLI::App& app, ParsedCommand& selected_command);
void add_convert_command(CLI::App& app, ParsedCommand& selected_command);
void add_info_command(CLI::App& app, ParsedCommand& selected_command);
void add_train_command(CLI::App& app, ParsedCommand& selected_command);
void add_refine_command(CLI::App& app, ParsedCommand& selected_command);
void add_serve_command(CLI::App& app, ParsedCommand& selected_command);
void add_edit_command(CLI::App& app, ParsedCommand& selected_command);
void add_assets_command(CLI::App& app, ParsedCommand& selected_command);
void add_render_command(CLI::App& app, ParsedCommand& selected_command);
void add_eval_command(CLI::App& app, ParsedCommand& selected_command);
void add_export_command(CLI::App& app, ParsedCommand& selected_command);
void add_demo_command(CLI::App& app, ParsedCommand& selected_command);
void add_view_command(CLI::App& app, ParsedCommand& selected_command);
void add_check_command(CLI::App& app, ParsedCommand& selected_command);

}  // namespace relidar::cli
