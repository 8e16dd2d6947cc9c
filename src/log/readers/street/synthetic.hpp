// SPDX-License-Identifier: Apache-2.0
// Loads synthetic logs. The file street.toml contains the options of a log. The scans are
// generated from these options, because they are not stored.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Generates the frames [begin_frame, end_frame) of the log.
LidarSequence make_synthetic_frames(const SyntheticOptions& options, int begin_frame, int end_frame);

}  // namespace relidar
