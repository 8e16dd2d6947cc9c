// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/run/run.hpp>

namespace relidar::cli {

/// "first:end" (frame numbers of the dataset), "test", "train" or "all"; by default the
/// held-out frames, or all if none is held out.
/// @return positions in the list of frames
/// @throws UsageError if no frame is selected
std::vector<int> select_frames(const Run& run, const std::optional<std::string>& frames_text, bool quiet);

}  // namespace relidar::cli
