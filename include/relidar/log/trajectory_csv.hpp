// SPDX-License-Identifier: Apache-2.0
// Writes poses to a CSV file.
#pragma once

#include <filesystem>

namespace relidar {

struct PoseTrack;

/// Writes poses to a CSV file with the columns time_s,x,y,z,yaw_deg,pitch_deg,roll_deg.
/// Numbers keep their full precision. read_trajectory() and planners can read the
/// file, so users can edit the trajectory of a log.
/// @throws DataError if the file cannot be written
void write_trajectory(const std::filesystem::path& path, const PoseTrack& track);

}  // namespace relidar
