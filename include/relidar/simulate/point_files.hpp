// SPDX-License-Identifier: Apache-2.0
// Writes points as PLY, PCD and KITTI binary files.
#pragma once

#include <filesystem>

#include <relidar/base/files.hpp>
#include <relidar/read/points.hpp>

namespace relidar {

/// Writes points to a PLY file. Properties: x y z intensity (float32), ring (uint16),
/// time (float32), instance (int32), return (uint8) and the channels (float32 or int32;
/// NAME_x NAME_y NAME_z of a vector, but nx ny nz of "normal"). Unknown properties are
/// left out. A file without points still lists ring, time and instance.
/// @param notes comments in the header of the file
/// @throws DataError if lengths differ, and in the same cases as check_channels() and
/// write_atomically()
void write_ply(const std::filesystem::path& path, const LidarPoints& points, const FileMetadata& notes = {});
/// Writes points to a binary PCD 0.7 file. Its VIEWPOINT is `world_from_points`.
void write_pcd(const std::filesystem::path& path, const LidarPoints& points, const FileMetadata& notes = {});
/// Writes points as n x float32 x y z intensity, without a header.
void write_kitti_bin(const std::filesystem::path& path, const LidarPoints& points);

}  // namespace relidar
