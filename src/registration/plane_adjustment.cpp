// SPDX-License-Identifier: Apache-2.0
#include "registration/plane_adjustment.hpp"

#include <algorithm>
#include <span>

#include "base/parallel.hpp"
#include "registration/pose_equations.hpp"

namespace relidar {
namespace {

// Number of chunks of cells. It is fixed, so that rounding does not depend on threads.
constexpr int kChunks = 64;
// Number of optimisation rounds in which the grid cells for fitting planes shrink, and
// number of further rounds with the smallest cells.
constexpr int kShrinkingRounds = 8, kLastRounds = 2;
constexpr double kGridShift_cells = 0.37;  // Shift of the cell grid from one round to the next, in cells.
// converge_poses() uses several grids, in which the weight of a point falls to zero over
// this distance (in cells) from the border of its cell. Its cells shrink slowly, because
// otherwise slightly different points can converge to different minima. It stops if no
// pose moves by more than kConverged_m.
constexpr int kOverlappingGrids = 4, kSlowShrinkingRounds = 16, kMaxRounds = 60;
constexpr double kBorder_cells = 0.25, kConverged_m = 1e-4;
constexpr std::size_t kMinPlacedPoints = 30;  // minimum number of points on planes that determine a pose
constexpr double kMinShareOnPlanes = 0.05;    // minimum share of a registered scan's points on planes

std::vector<WorldPointWithOrigin> points_to_world(const PoseTrack& track,
                                                  const std::vector<SubsampledPoint>& points) {
    std::vector<WorldPointWithOrigin> placed(points.size());
    parallel_blocks(points.size(),
                    [&](std::size_t index) { placed[index] = point_to_world(track, points[index]); });
    return placed;
}

/// Returns the twists from the poses of the first track to the poses of the second track,
/// stacked in one vector with 6 values per pose.
Eigen::VectorXd stack_twists(const PoseTrack& first_track, const PoseTrack& second_track) {
    Eigen::VectorXd result(6 * Eigen::Index(first_track.pose.size()));
    for (std::size_t k = 0; k < first_track.pose.size(); ++k)
        block_of(result, k) = to_vector(compute_twist(first_track.pose[k], second_track.pose[k]));
    return result;
}

/// Sets the weight of each point in its cell. It is zero at the border of the cell, so
/// that a point enters and leaves a cell gradually. The mean sum over all grids is 1.
void fade_near_borders(std::vector<WorldPointWithOrigin>& points, double cell_m, double grid_shift_cells) {
    const double mean_sum = kOverlappingGrids * std::pow(1.0 - kBorder_cells, 3);
    for (WorldPointWithOrigin& point : points) {
        const glm::dvec3 in_cell = glm::fract(point.point_m / cell_m + grid_shift_cells);
        point.weight = 1.0 / mean_sum;
        for (int axis = 0; axis < 3; ++axis)
            point.weight *= smooth_step(std::min(in_cell[axis], 1.0 - in_cell[axis]), 0.0, kBorder_cells);
    }
}

/// Fits a plane in each cell that contains points from at least two sweeps.
/// @param fit  fit_plane() or fit_smooth_plane()
template <class Fit>
PlaneMap fit_cell_planes(const std::vector<SubsampledPoint>& points,
                         const std::vector<WorldPointWithOrigin>& world_points, const FitRound& round,
                         double grid_shift_cells, const Fit& fit) {
    PlaneMap map{PointCellGrid(world_points, round.cell_m, grid_shift_cells), {}};
    map.planes.resize(map.cells.size());
    parallel_blocks(map.cells.size(), [&](std::size_t cell) {
        const std::span<const std::uint32_t> point_indices = map.cells.points_in_cell(cell);
        // The points of a cell are sorted by pose. A plane that only one sweep observes
        // moves with the pose of this sweep, so it contributes nothing.
        const bool has_several_sweeps =
            points[point_indices.front()].pose != points[point_indices.back()].pose;
        if (has_several_sweeps)
            map.planes[cell] = fit(world_points, point_indices, round.cell_m, round.scale_m);
    });
    return map;
}

/// Returns the nearest selected poses before and after a pose. For a side on which no
/// pose is selected, returns `pose_index`.
std::pair<std::size_t, std::size_t> find_neighbours(std::size_t pose_index,
                                                    const std::vector<bool>& is_selected) {
    std::size_t before = pose_index, after = pose_index;
    for (std::size_t k = pose_index; k-- > 0 && before == pose_index;)
        if (is_selected[k]) before = k;
    for (std::size_t k = pose_index + 1; k < is_selected.size() && after == pose_index; ++k)
        if (is_selected[k]) after = k;
    return {before, after};
}

}  // namespace

const LocalPlane* PlaneMap::find_plane_at(const glm::dvec3& point_m) const {
    const std::optional<std::size_t> cell = cells.find_cell_at(point_m);
    return cell && planes[*cell] ? &*planes[*cell] : nullptr;
}

PoseAdjustment::PoseAdjustment(const PoseTrack& initial_track, const PoseTrack& start,
                               const PoseTrack& reference, const PoseCorrectionPrior& prior,
                               std::vector<SubsampledPoint> points, std::vector<bool> gauge)
    : initial_track_(initial_track),
      track_(start),
      reference_(reference),
      points_(std::move(points)),
      gauge_(std::move(gauge)),
      prior_(prior) {
    centre_poses();
    start_ = track_;
}

std::vector<FitRound> PoseAdjustment::adjust_poses(
    const FitRound& first_round_settings, const FitRound& last_round_settings,
    const std::function<bool(double finished_fraction)>& should_continue) {
    constexpr int kRounds = kShrinkingRounds + kLastRounds;
    std::vector<FitRound> rounds;
    for (int i = 0; i < kRounds && should_continue(i / double(kRounds)); ++i) {
        // The settings stop changing in round kShrinkingRounds. The grid moves in each
        // round, so that cell borders change.
        const double fraction = std::min(1.0, i / double(kShrinkingRounds - 1));
        const FitRound settings = blend_rounds(first_round_settings, last_round_settings, fraction);
        rounds.push_back(run_round(settings, sum_grid(settings, kGridShift_cells * i)));
    }
    return rounds;
}

void PoseAdjustment::converge_poses(const FitRound& first, const FitRound& last) {
    for (int i = 0; i < kMaxRounds; ++i) {
        const double fraction = std::min(1.0, i / double(kSlowShrinkingRounds - 1));
        const FitRound round = blend_rounds(first, last, fraction);
        if (run_round(round, sum_grids(round)).step_m < kConverged_m && fraction == 1.0) break;
    }
}

double PoseAdjustment::mean_weight(const FitRound& round) const {
    return sum_grids(round).weight() / double(points_.size());
}

PlaneMap PoseAdjustment::fit_planes(const FitRound& round_settings) const {
    return fit_cell_planes(points_, points_to_world(track_, points_), round_settings, 0.0, fit_plane);
}

/// Returns the equations of all points in one grid, from planes fitted by fit_plane().
PoseEquations PoseAdjustment::sum_grid(const FitRound& round, double grid_shift_cells) const {
    const std::vector<WorldPointWithOrigin> placed = points_to_world(track_, points_);
    const PlaneMap map = fit_cell_planes(points_, placed, round, grid_shift_cells, fit_plane);
    return sum_equations(placed, map, round.scale_m);
}

/// Returns the sum of the equations in several overlapping grids. It changes gradually
/// with the points, because no point or plane is added or removed suddenly.
PoseEquations PoseAdjustment::sum_grids(const FitRound& round) const {
    std::vector<WorldPointWithOrigin> placed = points_to_world(track_, points_);
    PoseEquations sum(track_.pose.size());
    for (int i = 0; i < kOverlappingGrids; ++i) {
        const double shift_cells = i / double(kOverlappingGrids);
        fade_near_borders(placed, round.cell_m, shift_cells);
        const PlaneMap map = fit_cell_planes(points_, placed, round, shift_cells, fit_smooth_plane);
        sum.add_equations(sum_equations(placed, map, round.scale_m));
    }
    return sum;
}

/// Returns the Gauss-Newton equations of all poses: the sum over the points in cells with
/// a plane. Threads sum over chunks of cells, and the chunks are added in their order.
/// @param scale_m  scale of the robust kernel, see make_residual()
PoseEquations PoseAdjustment::sum_equations(const std::vector<WorldPointWithOrigin>& world_points,
                                            const PlaneMap& map, double scale_m) const {
    std::vector<PoseEquations> chunk_sums(kChunks, PoseEquations(track_.pose.size()));
    const std::size_t chunk_size = map.cells.size() / kChunks + 1;
    parallel_ranges(map.cells.size(), chunk_size, [&](std::size_t begin, std::size_t end) {
        for (std::size_t cell = begin; cell < end; ++cell)
            if (map.planes[cell])
                chunk_sums[begin / chunk_size].add_cell(points_, world_points, map.cells.points_in_cell(cell),
                                                        *map.planes[cell], scale_m);
    });
    for (std::size_t chunk = 1; chunk < kChunks; ++chunk)
        chunk_sums[0].add_equations(std::move(chunk_sums[chunk]));
    return std::move(chunk_sums[0]);
}

/// Moves all poses by one Gauss-Newton step towards the planes fitted to their points.
/// @param equations  of the current poses
/// @return the settings with the statistics of this round
FitRound PoseAdjustment::run_round(FitRound round, PoseEquations equations) {
    add_prior(equations);
    const Eigen::VectorXd step = equations.solve_steps(track_);
    const PoseTrack previous = track_;
    for (std::size_t k = 0; k < track_.pose.size(); ++k)
        track_.pose[k] = apply_twist(track_.pose[k], to_twist(block_of(step, k)));
    centre_poses();  // undoes the motion of all poses together, which points leave open
    round.planes = equations.n_planes();
    round.residual_m = equations.rms_residual_m();
    for (std::size_t k = 0; k < track_.pose.size(); ++k)
        round.step_m =
            std::max(round.step_m, glm::distance(track_.pose[k].translation, previous.pose[k].translation));
    return round;
}

/// Adds the terms of the prior. They pull each correction to zero, and the motion between
/// consecutive poses to that of the reference track: weakly, the more the shorter the
/// time between the poses is, and strongly in a direction that the points do not show.
void PoseAdjustment::add_prior(PoseEquations& equations) const {
    constexpr double kLinkTime_s = 0.1;  // time between poses to which prior_.link refers
    std::vector<std::vector<UnobservedMotion>> unobserved =
        equations.find_unobserved(min_information(prior_.has_given_poses));
    // A scan with few points on planes is lost. Holding its pose would tie the poses
    // before and after it to each other.
    std::vector<std::size_t> n_points(track_.pose.size(), 0);
    for (const SubsampledPoint& point : points_) ++n_points[point.pose];
    for (std::size_t k = 0; k < n_points.size(); ++k)
        if (double(equations.count_on_planes(k)) < kMinShareOnPlanes * double(n_points[k]))
            unobserved[k].clear();
    const Eigen::VectorXd corrections = stack_twists(start_, track_);
    for (std::size_t k = 0; k < track_.pose.size(); ++k) {
        equations.add_zero_prior(k, prior_.pull, block_of(corrections, k));
        if (k + 1 == track_.pose.size()) break;
        const glm::dvec3 offset_m = track_.pose[k + 1].translation - track_.pose[k].translation;
        // An unobserved pose is held by the pose before it. The pose after it holds it
        // only if that is unobserved, too, because two observed neighbours must not be
        // tied to each other. The first pose has no pose before it.
        double share = k == 0 ? 1.0 : 0.0;
        for (const UnobservedMotion& motion : unobserved[k + 1]) share = std::max(share, motion.hidden);
        // The twist of the earlier pose is that of the later pose, seen from its place.
        const Matrix6 carry_back = twist_transfer(-offset_m);
        Matrix6 weights = hold_stiffness(unobserved[k + 1]) +
                          share * carry_back.transpose() * hold_stiffness(unobserved[k]) * carry_back;
        weights.diagonal() += kLinkTime_s / (track_.time_s[k + 1] - track_.time_s[k]) * prior_.link;
        const Pose expected = track_.pose[k] * inverse(reference_.pose[k]) * reference_.pose[k + 1];
        equations.add_motion_prior(k, weights, offset_m,
                                   to_vector(compute_twist(expected, track_.pose[k + 1])));
    }
}

/// Moves the track like one rigid body, so that the mean correction of some poses (those
/// selected by gauge_) is zero. The points do not determine this common motion.
void PoseAdjustment::centre_poses() {
    const auto n_gauge = double(std::ranges::count(gauge_, true));
    // Three passes are needed, because the mean of rotation vectors is only approximate.
    // Each pass removes most of the remaining mean.
    for (int pass = 0; pass < 3; ++pass) {
        glm::dvec3 centre_m(0.0), shift_m(0.0), rotation(0.0);  // means of the gauge poses
        for (std::size_t k = 0; k < track_.pose.size(); ++k) {
            if (!gauge_[k]) continue;
            const Twist correction = compute_twist(initial_track_.pose[k], track_.pose[k]);
            centre_m += initial_track_.pose[k].translation / n_gauge;
            shift_m += glm::dvec3(correction[0], correction[1], correction[2]) / n_gauge;
            rotation += glm::dvec3(correction[3], correction[4], correction[5]) / n_gauge;
        }
        // Shifts the track back, and then rotates it back about the centre.
        const glm::dquat back =
            apply_twist(Pose{}, {0, 0, 0, -rotation.x, -rotation.y, -rotation.z}).rotation;
        for (Pose& pose : track_.pose)
            pose = {glm::normalize(back * pose.rotation),
                    centre_m + back * (pose.translation - shift_m - centre_m)};
    }
}

double PoseAdjustment::time_fraction(std::size_t before, std::size_t pose, std::size_t after_index) const {
    const std::vector<double>& t = initial_track_.time_s;
    return (t[pose] - t[before]) / (t[after_index] - t[before]);
}

/// Interpolates unknown corrections over time between the nearest known corrections. At
/// the ends of the track, uses the nearest known correction.
void PoseAdjustment::fill_corrections(const std::vector<bool>& is_correction_known) {
    const Eigen::VectorXd corrections = stack_twists(reference_, track_);
    for (std::size_t k = 0; k < is_correction_known.size(); ++k) {
        if (is_correction_known[k]) continue;
        auto [before, after] = find_neighbours(k, is_correction_known);
        if (before == k && after == k) {  // no known pose exists
            track_.pose[k] = reference_.pose[k];
            continue;
        }
        if (before == k) before = after;  // at the start of the track
        if (after == k) after = before;   // at the end
        const double s = before == after ? 0.0 : time_fraction(before, k, after);
        const Vector6 earlier = block_of(corrections, before), later = block_of(corrections, after);
        track_.pose[k] = apply_twist(reference_.pose[k], to_twist(earlier + s * (later - earlier)));
    }
}

double PoseAdjustment::share_on_planes(const PlaneMap& map, const std::vector<SubsampledPoint>& points,
                                       double kernel_scale_m) const {
    std::size_t n_on_planes = 0;
    for (const SubsampledPoint& point : points) {
        const WorldPointWithOrigin placed = point_to_world(track_, point);
        const LocalPlane* plane = map.find_plane_at(placed.point_m);
        if (plane && make_residual(placed, *plane, kernel_scale_m).is_on_plane()) ++n_on_planes;
    }
    return points.empty() ? 0.0 : double(n_on_planes) / double(points.size());
}

bool PoseAdjustment::has_enough_planes(double fraction_on_planes, std::size_t n_points) {
    return fraction_on_planes >= kMinShareOnPlanes &&
           fraction_on_planes * double(n_points) >= double(kMinPlacedPoints);
}

double PoseAdjustment::deviation_m(std::size_t pose_index, const std::vector<bool>& is_neighbour) const {
    const auto [before, after] = find_neighbours(pose_index, is_neighbour);
    if (before == pose_index || after == pose_index) return 0.0;  // no neighbour on one side
    const auto correction = [&](std::size_t index) {
        return track_.pose[index].translation - initial_track_.pose[index].translation;
    };
    const glm::dvec3 between =
        glm::mix(correction(before), correction(after), time_fraction(before, pose_index, after));
    // The initial track can jump between this pose and one neighbour. Their corrections
    // then differ, although both are right. So the smallest difference counts.
    double least = glm::distance(correction(pose_index), between);
    for (const std::size_t neighbour : {before, after})
        least = std::min(least, glm::distance(correction(pose_index), correction(neighbour)));
    return least;
}

std::vector<std::size_t> PoseAdjustment::interpolate_lost(const SubsampledScans& scans,
                                                          const std::vector<double>& shares_on_planes,
                                                          const std::vector<bool>& pose_has_points,
                                                          double max_deviation_m) {
    std::vector<std::size_t> lost;
    std::vector<bool> is_registered = pose_has_points;
    for (std::size_t k = 0; k < is_registered.size(); ++k) {
        if (!pose_has_points[k]) continue;
        const bool has_failed = !has_enough_planes(shares_on_planes[k], scans[k].size()) ||
                                deviation_m(k, pose_has_points) > max_deviation_m;
        if (!has_failed) continue;
        lost.push_back(k);
        is_registered[k] = false;
    }
    fill_corrections(is_registered);
    return lost;
}

SinglePoseEquations PoseAdjustment::equations_of_pose(const PlaneMap& map, std::size_t pose_index,
                                                      const std::vector<SubsampledPoint>& points,
                                                      double kernel_scale_m) const {
    return sum_point_equations(points.size(), [&](SinglePoseEquations& sum, std::size_t i) {
        const WorldPointWithOrigin placed = point_to_world(track_, points[i]);
        const LocalPlane* plane = map.find_plane_at(placed.point_m);
        if (!plane) return;
        // A point moves less than this pose if it was measured between two poses.
        const double motion_fraction = weight_of_pose(points[i], pose_index);
        sum.add_residual(make_residual(placed, *plane, kernel_scale_m), motion_fraction);
    });
}

void PoseAdjustment::align_pose(const PlaneMap& map, std::size_t pose_index, const Pose& start,
                                const std::vector<SubsampledPoint>& points, double kernel_scale_m) {
    const SinglePoseEquations equations = equations_of_pose(map, pose_index, points, kernel_scale_m);
    equations.move_pose(track_.pose[pose_index], start,
                        equations.find_unobserved(min_information(prior_.has_given_poses)));
}

}  // namespace relidar
