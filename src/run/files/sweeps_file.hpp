// SPDX-License-Identifier: Apache-2.0
// Reads and writes sweeps.safetensors (LidarFrame::azimuth_shift_rad). Private to run.
#pragma once

#include <filesystem>

#include <relidar/log/sequence.hpp>

namespace relidar::files {

/// An array [columns] f4 in radians per frame, named by its index in scene.json. Frames
/// without corrections have no array. Writes no file if no frame has corrections.
void save_azimuth_corrections(const std::filesystem::path& path, const LidarSequence& sequence);
/// @throws DataError for an array without a frame, with a wrong size, or with values
/// outside -pi ... pi
void load_azimuth_corrections(const std::filesystem::path& path, LidarSequence& sequence);

}  // namespace relidar::files
