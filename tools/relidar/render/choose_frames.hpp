// SPDX-License-Identifier: Apache-2.0
// Parses the option --frames of commands that process the frames of a run.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/run/run.hpp>

namespace relidar::cli {

/// Returns the positions of the selected frames in the run. The selection is "first:end"
/// (frame numbers of the dataset), "test", "train" or "all". Without a selection, the
/// held-out frames are returned, or all frames if none is held out.
/// @throws UsageError if no frame is selected
std::vector<int> choose_frames(const Run& run, const std::optional<std::string>& wanted, bool quiet);

}  // namespace relidar::cli
