// SPDX-License-Identifier: Apache-2.0
// The command `relidar list` prints the devices, sensors and settings that other commands
// accept.
#include <CLI/CLI.hpp>

#include "command.hpp"
#include "inspect/list.hpp"

namespace relidar::cli {

void add_list(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand("list", "list devices, sensors or settings and their properties");
    command->require_subcommand(1);
    add_device_list(*command, call);
    add_sensor_list(*command, call);
    add_setting_list(*command, call);
    command->footer(
        "Examples:\n"
        "  relidar list devices\n"
        "  relidar list sensors OS1-128\n"
        "  relidar list settings --preset quick");
}

}  // namespace relidar::cli
