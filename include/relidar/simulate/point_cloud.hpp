// SPDX-License-Identifier: Apache-2.0
// Point clouds as PLY, PCD and KITTI binary files.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/base/files.hpp>
#include <relidar/base/math.hpp>
#include <relidar/log/channels.hpp>

namespace relidar {

/// A point cloud. Fields that a cloud does not have are left out of its files; one that
/// it has is there without a point too.
struct PointCloud {
    std::vector<glm::vec3> position_m;                    ///< [n]
    std::vector<float> intensity;                         ///< [n] 0..1
    std::optional<std::vector<std::uint16_t>> ring = {};  ///< [n] number of the beam, 0 = highest
    std::optional<std::vector<float>> time = {};          ///< [n] seconds from the scan's reference time
    /// [n] whose surface, index into Scene::instances
    std::optional<std::vector<std::int32_t>> instance = {};
    std::optional<std::vector<std::uint8_t>> return_number = {};  ///< [n] of its ray, from 1
    std::vector<ScanChannel> channels = {};                       ///< [n] each
    Pose world_from_points = {};  ///< takes the points to the world: VIEWPOINT of a PCD
    FileNotes notes = {};         ///< comments of PLY and PCD
};
/// Point cloud files: x y z intensity (float32), ring (uint16), time (float32), instance
/// (int32), return (uint8), then the channels (float32 or int32; NAME_x NAME_y NAME_z of
/// vectors, of the channel "normal" in PLY nx ny nz, as readers know them).
/// @throws DataError where lengths differ, as check_channels(), as for write_atomically
void write_ply(const std::filesystem::path& path, const PointCloud& cloud);  ///< binary little-endian
void write_pcd(const std::filesystem::path& path, const PointCloud& cloud);  ///< PCD 0.7, binary
/// n x float32 x y z intensity
void write_kitti_bin(const std::filesystem::path& path, const PointCloud& cloud);

}  // namespace relidar
