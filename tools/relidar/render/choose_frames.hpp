// SPDX-License-Identifier: Apache-2.0
// --frames of commands that work on frames of a run.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/run/run.hpp>

namespace relidar::cli {

/// Positions of the wanted frames: "first:end" by the dataset's own numbers, "test",
/// "train" or "all". Where nobody says which, those held out, or all where none was.
/// @throws UsageError where there is none
std::vector<int> choose_frames(const Run& run, const std::optional<std::string>& wanted, bool quiet);

}  // namespace relidar::cli
