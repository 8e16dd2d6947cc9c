// SPDX-License-Identifier: Apache-2.0
// Parses --frames for commands that process frames of a run.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/run/run.hpp>

namespace relidar::cli {

/// Returns the positions of the selected frames: "first:end" by the dataset's frame
/// numbers, "test", "train" or "all". Without a selection, returns the held-out frames,
/// or all frames if none is held out.
/// @throws UsageError if no frame is selected
std::vector<int> choose_frames(const Run& run, const std::optional<std::string>& wanted, bool quiet);

}  // namespace relidar::cli
