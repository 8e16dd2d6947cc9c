// SPDX-License-Identifier: Apache-2.0
// Selects the points for registration: a few thousand points per scan, evenly distributed
// over the surfaces. Points in moving boxes are skipped.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/registration/registration.hpp>

namespace relidar {

/// Sweeps whose poses are registered. A sweep contains the frames of all LiDARs at one
/// vehicle pose. Sweeps without a frame of the main LiDAR (the one with the most returns
/// in the log) are not stored here. The corrections of their poses are interpolated.
struct SweepSet {
    PoseTrack track;                       ///< [sweeps] poses of the vehicle before registration
    std::vector<std::size_t> pose;         ///< [sweeps] index in Log::world_from_vehicle, ascending
    std::vector<std::vector<int>> frames;  ///< [sweeps] indices in Log::frames
};
/// Groups frames into sweeps, one for each vehicle pose with a frame of the main LiDAR.
SweepSet group_sweeps(const Log& log);
/// Corrects all poses of a log. Interpolates the corrections between registered sweeps.
/// @param corrected  poses of the sweeps after the registration
PoseTrack spread_corrections(const PoseTrack& initial, const SweepSet& sweeps, const PoseTrack& corrected);

/// A measured point, and the two poses of the track between which it was measured.
struct SubsampledPoint {
    glm::vec3 point_m;  ///< position in the vehicle frame at the firing time
    float s = 0.0f;     ///< interpolation weight of the pose with index left + 1
    std::uint32_t left = 0;
    std::uint32_t pose = 0;  ///< index of the sweep that contains the point
};
/// [sweeps] points of each scan, by frame and ray; empty if not used
using SubsampledScans = std::vector<std::vector<SubsampledPoint>>;

/// World positions of a point, and of the vehicle when it measured the point.
struct WorldPointWithOrigin {
    glm::dvec3 point_m, vehicle_m;
    double weight = 1.0;  ///< below 1 near the border of a cell, see fade_near_borders()
};
/// Moves a point to the world frame, with the pose interpolated at its firing time.
WorldPointWithOrigin point_to_world(const PoseTrack& track, const SubsampledPoint& point);
/// The vehicle pose at the firing time of a point is interpolated between two poses of
/// the track. Returns the weight of pose `pose_index` in this interpolation.
double weight_of_pose(const SubsampledPoint& point, std::size_t pose_index);

/// Selects returns of a frame, at most one in each cell of size `cell_size_m` in the
/// sensor frame. Skips returns in moving boxes.
/// @return indices in the order of the scan
std::vector<std::size_t> select_returns(const Log& log, int frame, const RegistrationOptions& options,
                                        double cell_size_m);
/// Returns the measured point of one ray of a frame, corrected by the range offset of its
/// beam, with the two vehicle poses of `track` between which the ray was fired.
/// @param pose_index index in `track` of the pose of this frame
SubsampledPoint make_point(const Log& log, const PoseTrack& track, std::size_t pose_index, int frame,
                           std::size_t ray);
/// Returns some points of the selected sweeps, those of select_returns() in each frame.
SubsampledScans thin_sweeps(const Log& log, const SweepSet& sweeps,
                            const std::vector<bool>& is_sweep_selected, const RegistrationOptions& options,
                            double cell_size_m);

}  // namespace relidar
