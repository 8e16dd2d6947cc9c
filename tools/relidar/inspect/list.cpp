// SPDX-License-Identifier: Apache-2.0
// The command `relidar list` prints the devices, sensors and settings that other commands
// accept.
#include <CLI/CLI.hpp>

#include "command.hpp"

namespace relidar::cli {

void add_list(CLI::App& app, ParsedCommand& call) {
    CLI::App* command = app.add_subcommand("list", "list devices, sensors or settings and their properties");
    command->require_subcommand(1);
    add_list_devices(*command, call);
    add_list_sensors(*command, call);
    add_list_settings(*command, call);
    command->footer(
        "Examples:\n"
        "  relidar list devices\n"
        "  relidar list sensors OS1-128\n"
        "  relidar list settings --preset quick");
}

}  // namespace relidar::cli
