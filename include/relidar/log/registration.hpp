// SPDX-License-Identifier: Apache-2.0
// Registration of scans: where the sensor was, from the scans alone, so that no wall is
// drawn twice (docs/method.md section 6).
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <relidar/base/process_group.hpp>
#include <relidar/base/progress.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

struct RegisterOptions {
    /// a scan whose correction is farther from its neighbours' counts as lost; also how
    /// far apart the same surface may lie for two scans before the adjustment
    double largest_m = 1.0;
    /// the poses say how the sensor moved from scan to scan; false: only the scans do
    bool given_motion = true;
    std::vector<BoxTrack> movers;            ///< their points are not the street's
    double mover_margin_m = kMoverMargin_m;  ///< boxes are grown by this
    /// asked before every scan and round; true ends registration with nothing changed
    std::function<bool()> stop;
    Progress progress = {};   ///< of both parts
    ProcessGroup group = {};  ///< processes that register the same log
};

/// One round: planes are fitted to the cells of a grid, then all poses take one step
/// towards them.
struct RegisterRound {
    double cell_m = 0.0;
    double scale_m = 0.0;    ///< at this distance from its plane a point counts a quarter
    std::size_t planes = 0;  ///< that two scans or more lie on
    /// weighted root mean square distance of points from their planes, before the step
    double residual_m = 0.0;
    double step_m = 0.0;  ///< longest translation of the step
};

struct Registration {
    PoseTrack world_from_vehicle;  ///< corrected; the log's own where stopped
    std::vector<RegisterRound> rounds;
    /// entries of world_from_vehicle that their own scans did not place: moved as their
    /// neighbours were
    std::vector<std::size_t> lost;
    /// share of a training scan's points that lie on common planes, the median over scans
    double on_planes = 0.0;
    std::size_t places_again = 0;  ///< at which a later pass through a road was put on an earlier one
    double loops_off_m = 0.0;      ///< by which one of them was off, the most
    bool stopped = false;
    bool done = false;  ///< false: the poses are the log's own
};

/// Finds poses of the sensor at which all scans lie on common planes. First scan by scan,
/// each on the map of those before it, starting where the given poses say that it moved;
/// then where a road is driven again the later pass on the earlier one; then all at once:
///   min over all poses and planes (n, d) of  sum over points p of rho(n . p - d),  rho(r) = r^2 / (1 + r^2 / s^2),
/// each point moving with the poses between which it was fired. So given poses may drift
/// by metres, or jump. What all poses have in common cannot be seen: the mean correction
/// is zero, or without given motion the pose in the middle stays. Held-out scans shape no
/// plane and move no other pose than their own, which is found last, on the planes of the
/// training scans. Deterministic, whatever the number of threads and processes. One
/// training scan is left where it is. A process group shares the first step; the rest is
/// the first process's alone, and the others return without it. Of several LiDARs those
/// take part that sweep at the same times as the one with the most returns: what they see
/// at one time is one scan of the vehicle. Others ride along, as they are mounted.
/// @throws DataError where no two training scans see a common surface
Registration register_scans(const Sequence& sequence, const Split& split, const RegisterOptions& options);

/// What a scene shows along a ray: a point of the surface and its normal, in the world. A
/// normal of 0: no surface.
struct SeenSurface {
    glm::dvec3 point_m{0.0}, normal{0.0};
};

/// What a scene shows along rays of a frame. @param position  of the frame in
/// Sequence::frames @param rays  indices into its scan
/// @param world_from_vehicle  poses to look from @return [rays]
using SceneView = std::function<std::vector<SeenSurface>(int position, const std::vector<std::size_t>& rays,
                                                         const PoseTrack& world_from_vehicle)>;

/// Where a scan lies on a scene.
struct ScanPlacement {
    Pose world_from_vehicle;  ///< as it was where the scan was not found
    double moved_m = 0.0;
    double on_surfaces = 0.0;  ///< share of its thinned points that lie on surfaces
    bool found = false;
};

/// Moves one pose of the vehicle, while the scene and all other poses stay:
///   min over the pose of  sum over points p of rho(n . (p - q)),  rho as above,
/// the points of all LiDARs that swept then, none of movers; q and n the surface that the
/// scene shows along the point's ray, looked at anew after each Gauss-Newton step. @param
/// pose  entry of Sequence::world_from_vehicle
ScanPlacement place_scan(const Sequence& sequence, std::size_t pose, const SceneView& view,
                         const RegisterOptions& options);

}  // namespace relidar
