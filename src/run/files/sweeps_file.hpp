// SPDX-License-Identifier: Apache-2.0
// sweeps.safetensors: where the head pointed in each sweep of a run's log
// (Frame::azimuth_shift_rad). Private to run.
#pragma once

#include <filesystem>

#include <relidar/log/sequence.hpp>

namespace relidar::run_detail {

/// An array [columns] f4, radians, for each frame that has one, named by the frame's
/// place in scene.json. No frame has one: no file.
void save_sweeps(const std::filesystem::path& path, const Sequence& sequence);
/// Gives the frames what the file has. @throws DataError for arrays of no frame, of the
/// wrong size, or out of -pi ... pi
void load_sweeps(const std::filesystem::path& path, Sequence& sequence);

}  // namespace relidar::run_detail
