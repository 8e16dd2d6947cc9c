// SPDX-License-Identifier: Apache-2.0
// The commands of relidar-dev.
#pragma once

#include "command.hpp"

namespace relidar::cli {

void add_bench(CLI::App& app, ParsedCommand& selected_command);
void add_pipelines(CLI::App& app, ParsedCommand& selected_command);

}  // namespace relidar::cli
