// SPDX-License-Identifier: Apache-2.0
// Writes poses to a CSV file.
#pragma once

#include <filesystem>
#include <optional>

#include <relidar/log/georeference.hpp>

namespace relidar {

struct PoseTrack;

/// Writes poses to a CSV file with the columns time_s,x,y,z,yaw_deg,pitch_deg,roll_deg.
/// Numbers keep their full precision. read_trajectory() and planners can read the
/// file, so users can edit the trajectory of a log.
/// @param earth  if set, the columns are latitude_deg,longitude_deg,height_m instead of
/// x,y,z, and the angles are relative to east, north and up
/// @throws DataError if the file cannot be written
void write_trajectory(const std::filesystem::path& path, const PoseTrack& track,
                      const std::optional<GeoConverter>& earth = {});

}  // namespace relidar
