// SPDX-License-Identifier: Apache-2.0
// Reads and writes sweeps.safetensors. The file stores the measured azimuths of the LiDAR
// head in each sweep of a run's log (LidarFrame::azimuth_shift_rad). Private to run.
#pragma once

#include <filesystem>

#include <relidar/log/sequence.hpp>

namespace relidar::run_detail {

/// Writes the azimuth corrections of each frame as an array [columns] f4 in radians. The
/// name of the array is the index of the frame in scene.json. A frame without corrections
/// has no array. Writes no file if no frame has corrections.
void save_azimuth_corrections(const std::filesystem::path& path, const LidarSequence& sequence);
/// Reads the azimuth corrections of all frames and stores them in the frames.
/// @throws DataError for an array without a frame, with a wrong size, or with values
/// outside -pi ... pi
void load_azimuth_corrections(const std::filesystem::path& path, LidarSequence& sequence);

}  // namespace relidar::run_detail
