// SPDX-License-Identifier: Apache-2.0
// The commands of relidar-dev.
#pragma once

#include "command.hpp"

namespace relidar::cli {

void add_dev_bench(CLI::App& app, Call& call);
void add_pipelines(CLI::App& app, Call& call);

}  // namespace relidar::cli
