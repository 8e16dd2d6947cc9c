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
/// How far a point moves along with a pose of the track: 1 for all of it.
double share_of(const ThinPoint& point, std::size_t pose);

/// Rays of a frame's returns, at most one a cell of edge cell_m in the sensor's frame, none of a mover. @return in the order of the scan
std::vector<std::size_t> thin_rays(const Sequence& sequence, int position, const RegisterOptions& options, double cell_m);
/// A return of a frame, its beam's offset taken off.
ThinPoint point_of(const Sequence& sequence, int position, std::size_t ray);
/// At most one point a cell of edge cell_m in each scan's sensor frame. @return by position in `positions`, in the order of the scan
std::vector<std::vector<ThinPoint>> thin_scans(const Sequence& sequence, const std::vector<int>& positions, const RegisterOptions& options,
                                               double cell_m);

}  // namespace relidar
