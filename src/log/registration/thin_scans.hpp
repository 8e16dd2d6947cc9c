// SPDX-License-Identifier: Apache-2.0
// Selects the points for registration: a few thousand points per scan, evenly distributed
// over the surfaces. Points in moving boxes are skipped.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/registration.hpp>

namespace relidar {

/// Sweeps to register, at the sweep times of the LiDAR with the most returns. Frames of
/// other LiDARs with the same time belong to the sweep. Poses at other times are
/// interpolated.
struct Sweeps {
    PoseTrack track;                       ///< [sweeps] poses of the vehicle before registration
    std::vector<std::size_t> pose;         ///< [sweeps] index in Sequence::world_from_vehicle, ascending
    std::vector<std::vector<int>> frames;  ///< [sweeps] indices in Sequence::frames
};
Sweeps group_frames_by_sweep(const Sequence& sequence);
/// Corrects all poses of a log by the corrections of the registered sweeps, interpolated
/// in between.
PoseTrack apply_correction_to_track(const PoseTrack& initial_track, const Sweeps& sweeps,
                                    const PoseTrack& corrected_track);

/// A measured point, with a reference to the two poses of the track between which it was
/// measured.
struct ThinPoint {
    glm::vec3 point_m;  ///< position in the vehicle frame at the firing time
    float s = 0.0f;     ///< interpolation weight of the pose left + 1
    std::uint32_t left = 0;
    std::uint32_t pose = 0;  ///< index of the sweep that contains the point
};

/// Number of points whose equations one parallel task sums.
inline constexpr std::size_t kPointsOfPart = 512;

/// Positions of a point, and of the vehicle when it measured the point, in the world
/// frame.
struct PlacedPoint {
    glm::dvec3 point_m, vehicle_m;
};
PlacedPoint place_point_in_world(const PoseTrack& track, const ThinPoint& point);
/// Returns how much of the motion of a pose a point follows, 0 to 1.
double get_pose_share(const ThinPoint& point, std::size_t pose);

/// Selects returns of a frame, at most one in each cell of size `cell_m` in the sensor
/// frame. Skips returns in moving boxes.
/// @return indices in the order of the scan
std::vector<std::size_t> thin_rays(const Sequence& sequence, int position, const RegisterOptions& options,
                                   double cell_m);
/// Computes the 3D point of one ray of a frame, corrected by the range offset of its
/// beam.
/// @param track poses of the sensor; the pose of the ray is interpolated
/// @param pose index in `track` of the pose of this frame
ThinPoint make_thin_point(const Sequence& sequence, const PoseTrack& track, std::size_t pose, int position,
                          std::size_t ray);
/// Selects points of some sweeps, at most one per scan in each cell of size `cell_m` in
/// the sensor frame.
/// @param chosen [sweeps] true for the sweeps to use
/// @return [sweeps] points frame by frame in the order of the scan; empty for sweeps that
/// are not chosen
std::vector<std::vector<ThinPoint>> thin_scans(const Sequence& sequence, const Sweeps& sweeps,
                                               const std::vector<bool>& chosen,
                                               const RegisterOptions& options, double cell_m);

}  // namespace relidar
