// SPDX-License-Identifier: Apache-2.0
// Registration: estimates the poses of the vehicle from the scans. With these poses, the
// same wall has the same position in all scans (docs/method.md section 6).
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <relidar/base/process_group.hpp>
#include <relidar/base/progress.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

struct RegistrationOptions {
    /// Largest pose error, metres, that registration can correct. Also limits the initial
    /// distance between two observations of the same surface. The registration of a scan
    /// counts as failed if its correction differs from the corrections of neighbouring
    /// scans by more than this value.
    double largest_m = 1.0;
    /// True: the motion between consecutive scans is computed from the given poses.
    /// False: it is estimated from the scans alone.
    bool use_pose_motion = true;
    std::vector<BoxTrack> movers;  ///< Boxes of moving objects. Points inside these boxes are ignored.
    double mover_margin_m = kMoverMargin_m;  ///< boxes are enlarged by this margin
    /// Polled before each scan and each round of the joint optimisation of all poses. If
    /// it returns true, registration stops and leaves the poses unchanged.
    std::function<bool()> stop;
    ProgressReporter progress = {};  ///< receives the progress of both parts
    ProcessGroup group = {};         ///< processes that register the same log together
};

/// Statistics of one round of the adjustment, which optimizes all poses together. A round
/// fits planes to the points in the cells of a grid. It then moves all poses by a step
/// that reduces the distances of the points from these planes.
struct RegistrationRound {
    double cell_m = 0.0;
    double scale_m = 0.0;    ///< Distance from the plane at which a point has a quarter of its full weight.
    std::size_t planes = 0;  ///< number of planes that at least two scans observe
    /// Weighted root mean square distance of the points from their planes. Measured
    /// before the step of this round.
    double residual_m = 0.0;
    double step_m = 0.0;  ///< longest translation of a pose in this step
};

struct RegistrationResult {
    /// Corrected poses of the vehicle. Equal to the poses of the log if `done` is false,
    /// for example because RegistrationOptions::stop has ended the registration.
    PoseTrack world_from_vehicle;
    std::vector<RegistrationRound> rounds;
    /// Scans that could not be registered, as indices into world_from_vehicle. The poses
    /// of these scans get the same correction as the neighbouring poses.
    std::vector<std::size_t> lost;
    /// Fraction of a scan's points that lie on planes which several scans observe. Median
    /// over all training scans.
    double on_planes = 0.0;
    /// Number of loop closures. A loop closure aligns the second pass over a road with
    /// the first pass.
    std::size_t n_loop_closures = 0;
    double largest_loop_error_m = 0.0;  ///< Largest position error, in metres, that a loop closure corrected.
    bool stopped = false;
    bool done = false;  ///< false: the poses are those of the log
};

/// Estimates poses of the vehicle at which all scans agree on common planes, in three
/// steps:
/// 1. Odometry: each scan is registered to a map of the previous scans. The motion
/// between the given poses is the start value.
/// 2. Loop closure: where a road is driven again, the later pass is aligned with the
/// earlier pass.
/// 3. Adjustment of all poses together, which minimises the error below.
///
/// Error of the adjustment; each point p moves with the two poses between which it was
/// fired:
///   min over all poses and planes (n, d) of  sum over points p of rho(n . p - d)
///   rho(r) = r^2 / (1 + r^2 / s^2)
/// Given poses may therefore drift by metres, or jump. A motion that is common to all
/// poses cannot be observed. Therefore the mean correction is zero. If no motion is
/// given, the middle pose is fixed instead.
///
/// Held-out scans do not affect the planes or the poses of other scans. The poses of
/// held-out scans are estimated last, on the planes of the training scans. The result
/// does not depend on the number of threads and processes. If there is only one training
/// scan, its pose is not changed.
///
/// The processes of a group share the first step. Only the first process computes the
/// other steps; the other processes return without a result.
///
/// The LiDAR with the most returns is the reference. If another LiDAR sweeps at the same
/// times, its measurements are combined with those of the reference to a single scan of
/// the vehicle. All other LiDARs keep their mounting on the vehicle.
/// @throws DataError if no two training scans observe a common surface
RegistrationResult register_scans(const LidarSequence& sequence, const TrainTestSplit& split,
                                  const RegistrationOptions& options);

/// The surface of a scene that a ray hits: a point and its normal, both in the world
/// frame. A normal of 0 means that the ray hits no surface.
struct SurfaceHit {
    glm::dvec3 point_m{0.0}, normal{0.0};
};

/// Callback that casts rays of a frame into a scene, and returns the surface that each
/// ray hits.
/// @param position  index of the frame in LidarSequence::frames
/// @param rays  indices of the rays in the frame's scan
/// @param world_from_vehicle  poses from which the rays are cast
/// @return [rays] one surface for each ray
using SceneRayCaster = std::function<std::vector<SurfaceHit>(
    int position, const std::vector<std::size_t>& rays, const PoseTrack& world_from_vehicle)>;

/// Pose of a scan that was aligned with a scene.
struct ScanAlignment {
    /// Aligned pose. If the alignment failed, this is the pose before the alignment.
    Pose world_from_vehicle;
    double moved_m = 0.0;
    /// Fraction of the scan's points that lie on surfaces of the scene. Computed from a
    /// subset of the points.
    double on_surfaces = 0.0;
    bool is_aligned = false;
};

/// Aligns one pose of the vehicle with a scene. The scene and all other poses stay fixed:
///   min over the pose of  sum over points p of rho(n . (p - q)),
///   rho as in register_scans()
/// q and n are the point and the normal of the surface that the scene shows along the ray
/// of p. The surfaces are rendered again after each Gauss-Newton step. The function uses
/// the points of all LiDARs that swept at that time, except points of moving objects.
/// @param pose_index  index into LidarSequence::world_from_vehicle
ScanAlignment align_scan_with_scene(const LidarSequence& sequence, std::size_t pose_index,
                                    const SceneRayCaster& scene_view, const RegistrationOptions& options);

/// Result of register_actors(), which corrects the tracks of moving objects with the
/// measured points.
struct ActorRegistrationResult {
    std::size_t n_actors = 0;      ///< number of moving boxes that are long enough
    std::size_t n_registered = 0;  ///< number of tracks with new poses
    /// Number of boxes that stand still although their labels suggest a motion.
    std::size_t n_standing = 0;
    double moved_m = 0.0;  ///< median correction of the registered tracks
};

/// Corrects the poses of each moving box that is at least 1.2 m long, from the points
/// inside it. The points of all training frames then lie on common planes in the frame of
/// the box. The function minimises the error of register_scans(), with a prior that keeps
/// corrections small and slow. The mean correction is zero. Poses without points, for
/// example in held-out frames, are interpolated from the nearest registered poses. If the
/// points of a box fit one constant pose, the box gets that pose.
/// @param train_frame_indices  frames whose points are used
ActorRegistrationResult register_actors(LidarSequence& sequence, const std::vector<int>& train_frame_indices,
                                        const ProgressReporter& progress = {});

}  // namespace relidar
