// SPDX-License-Identifier: Apache-2.0
// Points that registration uses: a few thousand per scan, evenly distributed over the
// surfaces, without points in moving boxes.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/registration.hpp>

namespace relidar {

/// Sweeps that registration uses: one for each sweep time of the LiDAR with the most
/// returns, with the frames of other LiDARs at the same times. LiDARs that sweep at other
/// times are not registered themselves.
struct Sweeps {
    PoseTrack track;                       ///< [sweeps] given poses of the vehicle
    std::vector<std::size_t> pose;         ///< [sweeps] index in Sequence::world_from_vehicle, ascending
    std::vector<std::vector<int>> frames;  ///< [sweeps] indices in Sequence::frames
};
Sweeps sweeps_of(const Sequence& sequence);
/// Computes all poses of a log from the poses of its sweeps. Poses between two sweeps get
/// the interpolated correction.
PoseTrack ride_along(const PoseTrack& given, const Sweeps& sweeps, const PoseTrack& found);

/// A return, and the two poses of the track between which it was fired.
struct ThinPoint {
    glm::vec3 point_m;  ///< in the vehicle frame at its firing time
    float s = 0.0f;     ///< weight of pose left + 1
    std::uint32_t left = 0;
    std::uint32_t pose = 0;  ///< pose of the sweep that contains the point
};

/// Number of points whose equations one thread sums.
inline constexpr std::size_t kPointsOfPart = 512;

/// Position of a point, and of the vehicle when the point was fired.
struct PlacedPoint {
    glm::dvec3 point_m, vehicle_m;
};
PlacedPoint place(const PoseTrack& track, const ThinPoint& point);
/// Returns the share of a pose's motion that applies to a point, from 0 to 1.
double share_of(const ThinPoint& point, std::size_t pose);

/// Selects rays of a frame that have a return, at most one per cell of edge cell_m in the
/// sensor's frame. Excludes moving objects.
/// @return ray indices in the order of the scan
std::vector<std::size_t> thin_rays(const Sequence& sequence, int position, const RegisterOptions& options,
                                   double cell_m);
/// Returns the point of a ray, with the range offset of its beam removed.
/// @param track  track that defines the point's position between poses
/// @param pose  index in the track of the frame's sweep
ThinPoint point_of(const Sequence& sequence, const PoseTrack& track, std::size_t pose, int position,
                   std::size_t ray);
/// Selects at most one point per cell of edge cell_m in each scan's sensor frame.
/// @param chosen  [sweeps] sweeps to read
/// @return [sweeps] points frame by frame, in the order of the scan; empty for other
/// sweeps
std::vector<std::vector<ThinPoint>> thin_scans(const Sequence& sequence, const Sweeps& sweeps,
                                               const std::vector<bool>& chosen,
                                               const RegisterOptions& options, double cell_m);

}  // namespace relidar
