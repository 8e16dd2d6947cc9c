// SPDX-License-Identifier: Apache-2.0
// The points that registration looks at: a few thousand a scan, evenly over the surfaces,
// none of a moving box.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/registration.hpp>

namespace relidar {

/// What is registered: a sweep for each time at which the LiDAR with the most returns
/// sweeps, with what others saw at the same times. LiDARs that sweep at other times ride
/// along.
struct Sweeps {
    PoseTrack track;                       ///< [sweeps] the vehicle as given
    std::vector<std::size_t> pose;         ///< [sweeps] of Sequence::world_from_vehicle, ascending
    std::vector<std::vector<int>> frames;  ///< [sweeps] positions in Sequence::frames
};
Sweeps sweeps_of(const Sequence& sequence);
/// All poses of a log from those of its sweeps: what lies between two sweeps is corrected
/// by what lies between their corrections.
PoseTrack ride_along(const PoseTrack& given, const Sweeps& sweeps, const PoseTrack& found);

/// A return and between which poses of the track it was fired.
struct ThinPoint {
    glm::vec3 point_m;  ///< vehicle frame at its firing
    float s = 0.0f;     ///< share of pose left + 1
    std::uint32_t left = 0;
    std::uint32_t pose = 0;  ///< whose sweep it belongs to
};

/// Points of which the equations are summed by one thread.
inline constexpr std::size_t kPointsOfPart = 512;

/// Where a point lies, and the vehicle when it was fired.
struct PlacedPoint {
    glm::dvec3 point_m, vehicle_m;
};
PlacedPoint place(const PoseTrack& track, const ThinPoint& point);
/// How far a point moves along with a pose of the track: 1 for all of it.
double share_of(const ThinPoint& point, std::size_t pose);

/// Rays of a frame's returns, at most one a cell of edge cell_m in the sensor's frame,
/// none of a mover. @return in the order of the scan
std::vector<std::size_t> thin_rays(const Sequence& sequence, int position, const RegisterOptions& options,
                                   double cell_m);
/// A return of a frame, its beam's offset taken off. @param track  that it is placed by
/// @param pose  of the track, of the frame's sweep
ThinPoint point_of(const Sequence& sequence, const PoseTrack& track, std::size_t pose, int position,
                   std::size_t ray);
/// At most one point a cell of edge cell_m in each scan's sensor frame. @param chosen
/// [sweeps] @return [sweeps] frame by frame, in the order of the scan; none of sweeps
/// that are not chosen
std::vector<std::vector<ThinPoint>> thin_scans(const Sequence& sequence, const Sweeps& sweeps,
                                               const std::vector<bool>& chosen,
                                               const RegisterOptions& options, double cell_m);

}  // namespace relidar
