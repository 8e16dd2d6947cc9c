// SPDX-License-Identifier: Apache-2.0
// Whatever can be known to be wrong with a batch before its first job starts: a fleet that runs for a week does not find a typing error on
// its sixth day.
#pragma once

#include <string>
#include <vector>

#include "batch/plan.hpp"
#include <relidar/error.hpp>

namespace relidar::cli {

/// Settings, parts of logs, command lines of steps by the parser of the program itself, logs on disk, folders that two jobs would share or
/// that hold other things, trainings that were done otherwise before. Relative paths are of the working folder.
/// @return one line a job at most, with its name
std::vector<Error> check_plan(const BatchPlan& plan);

}  // namespace relidar::cli
