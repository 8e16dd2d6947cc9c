// SPDX-License-Identifier: Apache-2.0
// Selects the points for registration: a few thousand per scan, evenly distributed over
// the surfaces, and none in moving boxes.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/registration.hpp>

namespace relidar {

/// Sweeps that are registered. There is one for each sweep time of the LiDAR with the
/// most returns. It includes frames of other LiDARs with the same time. LiDARs with other
/// sweep times are not registered; their poses are interpolated.
struct Sweeps {
    PoseTrack track;                       ///< [sweeps] given poses of the vehicle
    std::vector<std::size_t> pose;         ///< [sweeps] index in Sequence::world_from_vehicle, ascending
    std::vector<std::vector<int>> frames;  ///< [sweeps] indices in Sequence::frames
};
Sweeps sweeps_of(const Sequence& sequence);
/// Returns all poses of a log, corrected by the registered poses of its sweeps. The
/// correction between two sweeps is interpolated.
PoseTrack ride_along(const PoseTrack& given, const Sweeps& sweeps, const PoseTrack& found);

/// A return, and the two poses of the track between which it was fired.
struct ThinPoint {
    glm::vec3 point_m;  ///< position in the vehicle frame at the firing time
    float s = 0.0f;     ///< weight of the pose left + 1
    std::uint32_t left = 0;
    std::uint32_t pose = 0;  ///< index of the sweep to which the point belongs
};

/// Number of points whose equations one thread sums at a time.
inline constexpr std::size_t kPointsOfPart = 512;

/// Position of a point in the world, and of the vehicle at its firing time.
struct PlacedPoint {
    glm::dvec3 point_m, vehicle_m;
};
PlacedPoint place(const PoseTrack& track, const ThinPoint& point);
/// Returns the share of a pose's motion with which a point moves, 0 .. 1.
double share_of(const ThinPoint& point, std::size_t pose);

/// Selects the rays of a frame's returns, at most one per cell of edge `cell_m` in the
/// sensor's frame. Skips returns in moving boxes.
/// @return indices in the order of the scan
std::vector<std::size_t> thin_rays(const Sequence& sequence, int position, const RegisterOptions& options,
                                   double cell_m);
/// Returns the point of a frame's return, with the range offset of its beam removed.
/// @param track track that places the point
/// @param pose index in the track of the frame's sweep
ThinPoint point_of(const Sequence& sequence, const PoseTrack& track, std::size_t pose, int position,
                   std::size_t ray);
/// Returns the thinned points of all chosen sweeps, at most one per cell of edge `cell_m`
/// in each scan's sensor frame.
/// @param chosen [sweeps]
/// @return [sweeps] points frame by frame in the order of the scan; empty for sweeps that
/// are not chosen
std::vector<std::vector<ThinPoint>> thin_scans(const Sequence& sequence, const Sweeps& sweeps,
                                               const std::vector<bool>& chosen,
                                               const RegisterOptions& options, double cell_m);

}  // namespace relidar
