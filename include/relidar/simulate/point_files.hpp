// SPDX-License-Identifier: Apache-2.0
// Points as PLY, PCD and KITTI binary files.
#pragma once

#include <filesystem>

#include <relidar/base/files.hpp>
#include <relidar/log/points.hpp>

namespace relidar {

/// Point cloud files: x y z intensity (float32), ring (uint16), time (float32), instance
/// (int32), return (uint8), then the channels (float32 or int32; NAME_x NAME_y NAME_z of
/// vectors, of the channel "normal" in PLY nx ny nz, as readers know them). Unknown
/// properties are left out. A file without points lists ring, time and instance, so that
/// all files of a scan folder have the same fields.
/// @param notes  comments of the file
/// @throws DataError where lengths differ, as check_channels(), as for write_atomically
void write_ply(const std::filesystem::path& path, const Points& points, const FileNotes& notes = {});
/// PCD 0.7, binary. Its VIEWPOINT is world_from_points.
void write_pcd(const std::filesystem::path& path, const Points& points, const FileNotes& notes = {});
/// n x float32 x y z intensity
void write_kitti_bin(const std::filesystem::path& path, const Points& points);

}  // namespace relidar
