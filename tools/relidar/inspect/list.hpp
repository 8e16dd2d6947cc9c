// SPDX-License-Identifier: Apache-2.0
// The subcommands of `relidar list`.
#pragma once

#include "command.hpp"

namespace relidar::cli {

void add_device_list(CLI::App& list, Call& call);
void add_sensor_list(CLI::App& list, Call& call);
void add_setting_list(CLI::App& list, Call& call);

}  // namespace relidar::cli
