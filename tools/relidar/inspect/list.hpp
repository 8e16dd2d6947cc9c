// SPDX-License-Identifier: Apache-2.0
// The subcommands of `relidar list`.
#pragma once

#include "command.hpp"

namespace relidar::cli {

void add_list_devices_command(CLI::App& list_command, ParsedCommand& selected_command);
void add_list_sensors_command(CLI::App& list_command, ParsedCommand& selected_command);
void add_list_settings_command(CLI::App& list_command, ParsedCommand& selected_command);

}  // namespace relidar::cli
