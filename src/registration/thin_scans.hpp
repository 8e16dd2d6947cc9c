// SPDX-License-Identifier: Apache-2.0
// The points that registration looks at: a few thousand a scan, evenly over the surfaces, none of a moving box.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/registration.hpp>

namespace relidar {

/// A return and between which poses of the track it was fired.
struct ThinPoint {
    glm::vec3 point_m;    ///< sensor frame at its firing
    float s = 0.0f;       ///< share of pose left + 1
    std::uint32_t left = 0;
    std::uint32_t frame = 0;   ///< position in the sequence
};

/// Where a point lies, and the sensor when it was fired.
struct PlacedPoint {
    glm::dvec3 point_m, sensor_m;
};
PlacedPoint place(const PoseTrack& track, const ThinPoint& point);

/// At most one point a cell of edge cell_m in each scan's sensor frame. @return by position in `positions`, in the order of the scan
std::vector<std::vector<ThinPoint>> thin_scans(const Sequence& sequence, const std::vector<int>& positions, const RegisterOptions& options,
                                               double cell_m);

}  // namespace relidar
