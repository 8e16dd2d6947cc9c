// SPDX-License-Identifier: Apache-2.0
// Registration: estimates the poses of the vehicle from the scans. With these poses, the
// same wall has the same position in all scans (docs/method.md section 6).
#pragma once

#include <functional>
#include <vector>

#include <relidar/base/process_group.hpp>
#include <relidar/base/progress.hpp>
#include <relidar/log/log.hpp>

namespace relidar {

struct RegistrationOptions {
    /// Largest pose error, metres, that registration can correct. The registration of a
    /// scan failed if its correction differs from those of neighbouring scans by more.
    double largest_m = 1.0;
    /// The motion between consecutive scans comes from the given poses, or from the
    /// scans.
    bool use_pose_motion = true;
    std::vector<BoxTrack> movers;            ///< Points in these boxes of moving objects are ignored.
    double mover_margin_m = kMoverMargin_m;  ///< boxes are enlarged by this margin
    /// Polled before each scan and each round. If it returns true, registration stops and
    /// leaves the poses unchanged.
    std::function<bool()> stop;
    Progress progress = {};   ///< receives the progress of both parts
    ProcessGroup group = {};  ///< processes that register the same log together
};

/// Statistics of one round of the adjustment of all poses. A round fits planes to the
/// points in the cells of a grid, and moves all poses by a step towards these planes.
struct FitRound {
    double cell_m = 0.0;
    double scale_m = 0.0;    ///< Distance from the plane at which a point has a quarter of its full weight.
    std::size_t planes = 0;  ///< number of planes that at least two scans observe
    /// weighted RMS distance of the points from their planes before the step
    double residual_m = 0.0;
    double step_m = 0.0;  ///< longest translation of a pose in this step
};

/// A small motion of a pose that its scan hardly shows, for example along a tunnel. The
/// poses of the log, or their prediction, decide about this motion.
struct UnobservedMotion {
    Twist direction;  ///< the motion v: translation and rotation vector, in world axes
    /// a, with a . v = 1. The product a . x is the share of this motion in a twist x.
    Twist coordinate;
    double stiffness;  ///< weight of (a . x)^2 that holds the pose
    double hidden;     ///< 1: the scan does not show the motion, 0: it shows it
};

/// Returns the part of a twist x that the scan shows: x - sum over motions of hidden v
/// (a . x).
Twist remove_unobserved(const Twist& twist, const std::vector<UnobservedMotion>& unobserved);

struct RegistrationResult {
    /// Corrected poses of the vehicle, or those of the log if `done` is false.
    PoseTrack world_from_vehicle;
    std::vector<FitRound> rounds;
    /// Scans that could not be registered, as indices into world_from_vehicle. They get
    /// the same correction as the neighbouring poses.
    std::vector<std::size_t> lost;
    /// Fraction of a scan's points on planes which several scans observe, median over all
    /// training scans.
    double on_planes = 0.0;
    /// Number of alignments of a second pass over a road with the first pass.
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
/// 3. Adjustment of all poses together. Each point p moves with the two poses between
/// which it was fired:
///   min over all poses and planes (n, d) of  sum over points p of rho(n . p - d)
///   rho(r) = r^2 / (1 + r^2 / s^2)
/// Given poses may drift by metres, or jump. A motion that is common to all poses cannot
/// be observed, so the mean correction is zero, or the middle pose is fixed without given
/// motion.
///
/// Held-out scans are aligned last, with the planes of the training scans, and do not
/// affect other poses. The result does not depend on the number of threads and processes.
/// The processes of a group share the first step. Only the first process returns a
/// result.
///
/// Another LiDAR that sweeps at the same times as the LiDAR with the most returns is
/// combined with it. All other LiDARs keep their mounting on the vehicle.
/// @throws DataError if no two training scans observe a common surface
RegistrationResult register_scans(const Log& log, const Split& split, const RegistrationOptions& options);

/// Point and normal, world frame, of the surface that a ray hits. Normal 0: no surface.
struct SurfaceHit {
    glm::dvec3 point_m{0.0}, normal{0.0};
};

/// Callback that casts rays of a frame into a scene.
/// @param position  index of the frame in Log::frames
/// @param rays  indices of the rays in the frame's scan
/// @param world_from_vehicle  poses from which the rays are cast
/// @return [rays] one surface for each ray
using SceneCaster = std::function<std::vector<SurfaceHit>(int position, const std::vector<std::size_t>& rays,
                                                          const PoseTrack& world_from_vehicle)>;

/// Pose of a scan that was aligned with a scene.
struct ScanAlignment {
    /// Aligned pose, or the pose before if the alignment failed.
    Pose world_from_vehicle;
    double moved_m = 0.0;
    /// Fraction of the scan's points that lie on surfaces of the scene.
    double on_surfaces = 0.0;
    bool is_aligned = false;
};

/// Aligns one pose of the vehicle with a scene. The scene and all other poses stay fixed:
///   min over the pose of  sum over points p of rho(n . (p - q)),
///   rho as in register_scans()
/// The pose keeps the given unobserved motions. q and n are point and normal of the
/// surface that the scene shows along the ray of p, rendered again after each
/// Gauss-Newton step. Uses all LiDARs that swept at that time.
/// @param pose  index into Log::world_from_vehicle
/// @param unobserved  find_unobserved_motions() of this pose
ScanAlignment align_scan(const Log& log, std::size_t pose, const SceneCaster& scene_view,
                         const std::vector<UnobservedMotion>& unobserved, const RegistrationOptions& options);

/// Returns for each pose of the log which motions its scans do not show: those for which
/// the planes of other scans give hardly more information than the errors of their fitted
/// normals would give. A pose without a scan of the main LiDAR has the same as the
/// nearest pose with a scan.
/// @param map_frames  frames whose points form the planes
/// @return [poses of the log]
std::vector<std::vector<UnobservedMotion>> find_unobserved_motions(const Log& log,
                                                                   const std::vector<int>& map_frames,
                                                                   const RegistrationOptions& options);

struct ActorRegistrationResult {
    std::size_t n_actors = 0;      ///< number of moving boxes that are long enough
    std::size_t n_registered = 0;  ///< number of tracks with new poses
    /// number of boxes that stand still although their labels suggest a motion
    std::size_t n_standing = 0;
    double moved_m = 0.0;  ///< median correction of the registered tracks
};

/// Corrects the poses of each moving box that is at least 1.2 m long, so that the points
/// inside it lie on common planes in the frame of the box. Minimises the error of
/// register_scans(), with a prior that keeps corrections small and slow, and a mean
/// correction of zero. Poses without points are interpolated. If the points of a box fit
/// one constant pose, the box gets that pose.
/// @param frames  frames whose points are used
ActorRegistrationResult register_actors(Log& log, const std::vector<int>& frames,
                                        const Progress& progress = {});

}  // namespace relidar
