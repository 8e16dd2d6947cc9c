// SPDX-License-Identifier: Apache-2.0
// Registration: estimates the poses of the vehicle from the scans alone, so that the same
// wall has the same position in all scans (docs/method.md section 6).
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <relidar/base/process_group.hpp>
#include <relidar/base/progress.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

struct RegisterOptions {
    /// Maximum difference, in metres, between the correction of a scan and the
    /// corrections of its neighbours. A scan beyond it counts as lost. It is also the
    /// maximum distance between two observations of the same surface before the
    /// adjustment.
    double largest_m = 1.0;
    /// true: the given poses provide the motion from scan to scan. false: the motion is
    /// estimated from the scans alone.
    bool given_motion = true;
    std::vector<BoxTrack> movers;            ///< boxes of moving objects; points inside them are ignored
    double mover_margin_m = kMoverMargin_m;  ///< boxes are enlarged by this margin
    /// Polled before every scan and every round. If it returns true, registration stops
    /// and leaves the poses unchanged.
    std::function<bool()> stop;
    Progress progress = {};   ///< receives the progress of both parts
    ProcessGroup group = {};  ///< processes that register the same log together
};

/// Statistics of one round of the adjustment. A round fits planes to the cells of a grid,
/// then moves all poses by a step towards these planes.
struct RegisterRound {
    double cell_m = 0.0;
    double scale_m = 0.0;    ///< distance to its plane at which a point has a quarter of the full weight
    std::size_t planes = 0;  ///< number of planes that at least two scans observe
    /// Root mean square distance of points from their planes, weighted, before the step.
    double residual_m = 0.0;
    double step_m = 0.0;  ///< longest translation of a pose in this step
};

struct Registration {
    PoseTrack world_from_vehicle;  ///< corrected poses; the poses of the log if registration was stopped
    std::vector<RegisterRound> rounds;
    /// Indices into world_from_vehicle of poses whose scans could not be registered.
    /// These poses get the same correction as their neighbours.
    std::vector<std::size_t> lost;
    /// Fraction of a training scan's points that are on common planes. Median over all
    /// training scans.
    double on_planes = 0.0;
    /// number of places at which a later pass through a road was aligned with an earlier
    /// pass
    std::size_t places_again = 0;
    double loops_off_m = 0.0;  ///< largest position error that was corrected at such a place, in metres
    bool stopped = false;
    bool done = false;  ///< false: the poses are those of the log
};

/// Estimates poses of the vehicle at which all scans agree on common planes, in three
/// steps:
/// 1. Odometry: each scan is registered to a map of the previous scans. The start value
/// is the motion of the given poses.
/// 2. Loop closure: where a road is driven again, the later pass is aligned with the
/// earlier pass.
/// 3. Adjustment of all poses together, which minimises the error below.
///
/// Error of the adjustment; each point p moves with the two poses between which it was
/// fired:
///   min over all poses and planes (n, d) of  sum over points p of rho(n . p - d)
///   rho(r) = r^2 / (1 + r^2 / s^2)
/// Given poses may therefore drift by metres, or jump. A motion that is common to all
/// poses cannot be observed. So the mean correction is zero, or, without given motion,
/// the middle pose is fixed.
///
/// Held-out scans do not affect the planes or the poses of other scans. Their own poses
/// are estimated last, on the planes of the training scans. The result does not depend on
/// the number of threads and processes. If there is only one training scan, its pose is
/// not changed.
///
/// The processes of a group share the first step. Only the first process computes the
/// remainder; the others return without a result.
///
/// LiDARs that sweep at the same times as the one with the most returns are used
/// together: their measurements at the same time form a single scan of the vehicle. All
/// other LiDARs keep their mounting on the vehicle.
/// @throws DataError if no two training scans observe a common surface
Registration register_scans(const Sequence& sequence, const Split& split, const RegisterOptions& options);

/// The surface that a scene shows along a ray: a point and its normal, both in the world
/// frame. A normal of 0 means that there is no surface.
struct SeenSurface {
    glm::dvec3 point_m{0.0}, normal{0.0};
};

/// Callback that returns the surfaces that a scene shows along rays of a frame.
/// @param position  index of the frame in Sequence::frames
/// @param rays  indices of the rays in the frame's scan
/// @param world_from_vehicle  poses from which the rays are cast
/// @return [rays] one surface for each ray
using SceneView = std::function<std::vector<SeenSurface>(int position, const std::vector<std::size_t>& rays,
                                                         const PoseTrack& world_from_vehicle)>;

/// Pose of a scan that was aligned with a scene.
struct ScanPlacement {
    Pose world_from_vehicle;  ///< aligned pose; the original pose if the alignment failed
    double moved_m = 0.0;
    double on_surfaces = 0.0;  ///< fraction of the subsampled points of the scan that are on surfaces
    bool found = false;
};

/// Aligns one pose of the vehicle with a scene. The scene and all other poses stay fixed:
///   min over the pose of  sum over points p of rho(n . (p - q)),  rho as in register_scans().
/// It uses the points of all LiDARs that swept at that time, except points of moving
/// objects. q and n are the point and the normal of the surface that the scene shows
/// along the ray of p. They are rendered again after each Gauss-Newton step.
/// @param pose  index into Sequence::world_from_vehicle
ScanPlacement place_scan(const Sequence& sequence, std::size_t pose, const SceneView& view,
                         const RegisterOptions& options);

/// Result of register_actors().
struct ActorRegistration {
    std::size_t n_actors = 0;      ///< number of moving boxes that are long enough
    std::size_t n_registered = 0;  ///< number of tracks with new poses
    std::size_t n_standing = 0;    ///< number of boxes whose labels drift although they stand
    double moved_m = 0.0;          ///< median correction of the registered tracks
};

/// Registers each moving box of at least 2.5 m by its points. Corrects the poses of its
/// track so that the points of all training frames lie on common planes in the frame of
/// the box. It uses the equations of register_scans(), with a prior that keeps
/// corrections small and slow. The mean correction is zero. Poses without points, for
/// example in held-out frames, are interpolated from the nearest registered poses. A box
/// whose points fit one constant pose gets that pose.
/// @param train_positions  frames whose points are used
ActorRegistration register_actors(Sequence& sequence, const std::vector<int>& train_positions,
                                  const Progress& progress = {});

}  // namespace relidar
