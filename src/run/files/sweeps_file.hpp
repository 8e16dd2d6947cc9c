// SPDX-License-Identifier: Apache-2.0
// Reads and writes sweeps.safetensors (Frame::azimuth_shift_rad). Private to run.
#pragma once

#include <filesystem>

#include <relidar/log/sequence.hpp>

namespace relidar::files {

/// An array [columns] f4 in radians per frame, named by its index in scene.json. Frames
/// without corrections have no array. Writes no file if no frame has corrections.
void save_azimuths(const std::filesystem::path& path, const Log& sequence);
/// @throws DataError for an array without a frame, with a wrong size, or with values
/// outside -pi ... pi
void load_azimuths(const std::filesystem::path& path, Log& sequence);

}  // namespace relidar::files
