// SPDX-License-Identifier: Apache-2.0
// The program relidar-dev measures performance for developers. It is not installed.
#include "commands.hpp"
#include "program.hpp"

namespace {

void add_dev_commands(CLI::App& app, relidar::cli::ParsedCommand& selected_command) {
    relidar::cli::add_bench(app, selected_command);
    relidar::cli::add_pipelines(app, selected_command);
}

}  // namespace

int main(int argc, char** argv) {
    return relidar::cli::run_program(
        {"relidar-dev", "relidar-dev: measurements for developers of relidar",
         "The exit codes are those of relidar (see `relidar --help`).", add_dev_commands},
        argc, argv);
}
