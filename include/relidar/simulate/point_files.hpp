// SPDX-License-Identifier: Apache-2.0
// Writes points as PLY, PCD, LAS and KITTI binary files.
#pragma once

#include <filesystem>
#include <optional>

#include <relidar/base/files.hpp>
#include <relidar/read/points.hpp>

namespace relidar {

/// Writes points to a PLY file. Properties: x y z intensity (float32), ring (uint16),
/// time (float32), instance (int32), return (uint8) and the channels (float32 or int32;
/// NAME_x NAME_y NAME_z of a vector, but nx ny nz of "normal"). Unknown properties are
/// left out. A file without points still lists ring, time and instance.
/// @param notes comments in the header of the file
/// @param world_origin_m if set, is added to the positions, which are then float64
/// @throws DataError if lengths differ, and in the same cases as check_channels() and
/// write_atomically()
void write_ply(const std::filesystem::path& path, const LidarPoints& points, const FileMetadata& notes = {},
               const std::optional<glm::dvec3>& world_origin_m = {});
/// Writes points to a binary PCD 0.7 file. Its VIEWPOINT is `world_from_points`, or the
/// identity for points in the world.
/// @param world_origin_m as in write_ply()
void write_pcd(const std::filesystem::path& path, const LidarPoints& points, const FileMetadata& notes = {},
               const std::optional<glm::dvec3>& world_origin_m = {});
/// Writes points to a LAS 1.4 file: point format 6 with the other fields of write_ply()
/// as extra bytes. Coordinates have steps of 0.1 mm. GPS times are times of the log.
/// @param notes lines of a text record of the file
/// @param world_origin_m as in write_ply()
/// @param wkt coordinate system of the points; may be empty
/// @throws DataError in the cases of write_ply(), and for points 200 km from the origin
void write_las(const std::filesystem::path& path, const LidarPoints& points, const FileMetadata& notes = {},
               const std::optional<glm::dvec3>& world_origin_m = {}, const std::string& wkt = "");
/// Writes points as n x float32 x y z intensity, without a header.
void write_kitti_bin(const std::filesystem::path& path, const LidarPoints& points);

}  // namespace relidar
