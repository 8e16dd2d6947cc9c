// SPDX-License-Identifier: Apache-2.0
// Checks the frames that the user requests.
#pragma once

#include <string>

#include <relidar/read/dataset.hpp>

namespace relidar {

/// Returns the frames [begin, end) of a requested range in a log with n frames.
/// @throws UsageError if the range contains no frame of the log
FrameRange limit_frames(const FrameRange& range, int n_frames, const std::string& log_name);

/// Reports that a log has no frame in the requested range.
/// @param first,last  numbers of the frames of the log
[[noreturn]] void fail_empty_range(const FrameRange& range, const std::string& log_name, int first, int last);

}  // namespace relidar
