// SPDX-License-Identifier: Apache-2.0
// Poses as a CSV file.
#pragma once

#include <filesystem>

namespace relidar {

struct PoseTrack;

/// Poses as the CSV that read_trajectory() reads,
/// time_s,x,y,z,yaw_deg,pitch_deg,roll_deg, every number with all its digits: for
/// planners, and to begin a trajectory of one's own from a log's. @throws DataError as
/// for write_atomically
void write_trajectory(const std::filesystem::path& path, const PoseTrack& track);

}  // namespace relidar
