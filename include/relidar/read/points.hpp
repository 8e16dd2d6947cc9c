// SPDX-License-Identifier: Apache-2.0
// A set of points, as used by datasets, simulated scans, point cloud files, recordings
// and the render service.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/base/math.hpp>
#include <relidar/log/channels.hpp>
#include <relidar/log/classes.hpp>

namespace relidar {

/// Points in one frame, with an array per property. Arrays other than the position may be
/// empty.
struct LidarPoints {
    std::vector<glm::vec3> position_m;     ///< [n] positions in metres
    std::vector<float> intensity = {};     ///< [n] intensities, 0..1
    std::vector<std::uint16_t> ring = {};  ///< [n] beam numbers, 0 = highest
    /// [n] firing time of the ray, in seconds relative to time_s.
    std::vector<float> time_offset_s = {};
    /// [n] number of the return among the returns of the same ray; 1 is the strongest.
    std::vector<std::uint8_t> return_number = {};
    std::vector<std::uint32_t> firing = {};  ///< [n] index of the point's firing in SweepFirings::firings.
    /// [n] index in Scene::instances of the object that the ray hit; -1 if it hit no
    /// object.
    std::vector<std::int32_t> instance = {};
    std::vector<ScanChannel> channels = {};  ///< additional channels, [n] values each
    /// Pose of the frame of the points, in the world frame of the dataset. If each point
    /// is in the sensor frame at its own firing time, this is the pose of the sensor at
    /// time_s.
    Pose world_from_points = {};
    double time_s = 0.0;                     ///< reference time of the scan, in the time of the log
    std::vector<SurfaceClass> classes = {};  ///< [n] classes of labelled points

    std::size_t size() const { return position_m.size(); }
};

}  // namespace relidar
