// SPDX-License-Identifier: Apache-2.0
// What a command is: a function that adds a subcommand with its options to the parser,
// and leaves in `call.run` what to do when the user chose it. A new command is a file, a
// line here and a line in commands.cpp.
#pragma once

#include <functional>
#include <string>

#include <relidar/base/error.hpp>

namespace CLI {
class App;
}

namespace relidar::cli {

/// What the user asked for.
struct Call {
    std::string command_line;   ///< as typed, for reports
    std::function<void()> run;  ///< of the chosen command; failures are exceptions
};

/// Adds all of them.
void add_commands(CLI::App& app, Call& call);

void add_list(CLI::App& app, Call& call);
void add_convert(CLI::App& app, Call& call);
void add_info(CLI::App& app, Call& call);
void add_train(CLI::App& app, Call& call);
void add_refine(CLI::App& app, Call& call);
void add_serve(CLI::App& app, Call& call);
void add_edit(CLI::App& app, Call& call);
void add_assets(CLI::App& app, Call& call);
void add_render(CLI::App& app, Call& call);
void add_eval(CLI::App& app, Call& call);
void add_export(CLI::App& app, Call& call);
void add_demo(CLI::App& app, Call& call);
void add_view(CLI::App& app, Call& call);
void add_bench(CLI::App& app, Call& call);

}  // namespace relidar::cli
