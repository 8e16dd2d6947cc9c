// SPDX-License-Identifier: Apache-2.0
// Parses the option --frames of commands that process the frames of a run.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/run/run.hpp>

namespace relidar::cli {

/// Returns the positions of the selected frames in the list of frames of a run. The
/// selection is "first:end" (frame numbers of the dataset), "test", "train" or "all".
/// Without a selection, returns the held-out frames. If the run has no held-out frames,
/// returns all frames.
/// @throws UsageError if no frame is selected
std::vector<int> select_frame_indices_by_text(const TrainedRun& run,
                                              const std::optional<std::string>& frames_text, bool quiet);

}  // namespace relidar::cli
