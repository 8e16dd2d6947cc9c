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

namespace relidar {

/// Points in one frame, with one array per property. Each array has one entry per point,
/// or is empty if the property is unknown. Positions are always known.
struct Points {
    std::vector<glm::vec3> position_m;      ///< [n] positions in metres
    std::vector<float> intensity = {};      ///< [n] intensities, 0..1
    std::vector<std::uint16_t> ring = {};   ///< [n] beam numbers, 0 = highest
    std::vector<float> time_offset_s = {};  ///< [n] firing time of the ray, relative to time_s
    /// [n] number of the return within its ray, 1 = strongest
    std::vector<std::uint8_t> return_number = {};
    std::vector<std::uint32_t> firing = {};  ///< [n] index of the firing in Sweep::firings
    /// [n] index of the instance in Scene::instances, -1 = none
    std::vector<std::int32_t> instance = {};
    std::vector<ScanChannel> channels = {};  ///< additional channels, [n] values each
    /// Pose of the points' frame in the dataset's world. If each point is in the sensor
    /// frame at its own firing time, this is the sensor's pose at time_s.
    Pose world_from_points = {};
    double time_s = 0.0;  ///< reference time of the scan, in the time of the log

    std::size_t size() const { return position_m.size(); }
};

}  // namespace relidar
