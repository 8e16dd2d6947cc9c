// SPDX-License-Identifier: Apache-2.0
// A set of points: what a dataset's files list, what a simulated scan returns, and what
// point cloud files, recordings and the service hold.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/base/math.hpp>
#include <relidar/log/channels.hpp>

namespace relidar {

/// Points in one frame, an array for each property. Each array has one entry per point, or
/// is empty if the property is unknown. Positions are always known.
struct Points {
    std::vector<glm::vec3> position_m;             ///< [n] metres
    std::vector<float> intensity = {};             ///< [n] 0..1
    std::vector<std::uint16_t> ring = {};          ///< [n] number of the beam, 0 = highest
    std::vector<float> time_offset_s = {};         ///< [n] firing time of the ray, from time_s
    std::vector<std::uint8_t> return_number = {};  ///< [n] of the ray, 1 = strongest
    std::vector<std::uint32_t> firing = {};        ///< [n] index into Sweep::firings
    std::vector<std::int32_t> instance = {};       ///< [n] index into Scene::instances, -1 = none
    std::vector<ScanChannel> channels = {};        ///< [n] each
    /// Pose of the points' frame in the dataset's world. If each point is in the sensor's
    /// frame at its own firing time: the sensor's pose at time_s.
    Pose world_from_points = {};
    double time_s = 0.0;  ///< reference time of the scan, in the log's time

    std::size_t size() const { return position_m.size(); }
};

}  // namespace relidar
