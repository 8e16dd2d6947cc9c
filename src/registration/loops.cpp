// SPDX-License-Identifier: Apache-2.0
#include "registration/loops.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include <Eigen/SparseCholesky>

#include "registration/plane_maps.hpp"
#include "registration/pose_equations.hpp"

namespace relidar {
namespace {

constexpr double kKeyframeDistance_m = 4.0;  // path between keyframes, the poses that loop closures connect
constexpr double kMinPassDistance_m = 80.0;  // minimum path between passes; odometry has aligned closer ones
// A loop closure is searched between poses that are at most this far apart. As odometry
// drifts, the limit grows by kLoopDistanceGrowth per metre of path between the poses.
constexpr double kLoopDistance_m = 4.0, kLoopDistanceGrowth = 0.01, kMaxLoopDistance_m = 15.0;
// A scan is aligned with a map of the earlier pass. The map extends this distance along
// the road before and after the earlier pose that is nearest to the scan.
constexpr double kMapReach_m = 14.0;
// Registration tries a grid of start positions around the predicted pose. The values are
// the spacing of the grid, and its largest horizontal and vertical distance.
constexpr double kStartGridStep_m = 1.5, kMaxStartOffset_m = 6.0, kMaxStartHeight_m = 4.5;
// Penalty per grid step between a start position and the predicted position. The score of
// a start position is the share of points on planes of the map, minus this penalty.
constexpr double kGridPenalty = 0.01;
constexpr std::size_t kGridPoints = 400;  // points of a scan that give the score of a start position
// An alignment ends after kMaxLoopSteps steps per map level, or after a step shorter than
// kMinLoopStep_m.
constexpr int kMaxLoopSteps = 10;
constexpr double kMinLoopStep_m = 1e-3;
constexpr double kMinClosureShare = 0.4;  // minimum share of the scan's points on planes of the map
constexpr std::size_t kMinLoopClosures = 2;
constexpr double kOdometrySigma_m = 0.01, kOdometrySigma_rad = 3e-4;  // odometry errors between two keyframes
constexpr double kClosureSigma_m = 0.05, kClosureSigma_rad = 2e-3;    // standard deviations of a loop closure
// Scale of a robust kernel. A loop closure that contradicts the other loop closures by
// much more than this has almost no weight.
constexpr double kClosureKernel_m = 0.5;
constexpr int kClosureReweightings = 6;

/// The scan at a later keyframe was registered to the map of an earlier pass.
struct LoopClosure {
    std::size_t earlier, later;  // indices of the keyframes
    Twist off;                   // correction of the later pose: translation, then rotation vector
    Matrix6 observed;            // removes from a twist the motions that the scan does not show
};

/// Returns the weights of a twist with these standard deviations.
Matrix6 diagonal_weights(double sigma_m, double sigma_rad) {
    Vector6 weights;
    weights << Eigen::Vector3d::Constant(1.0 / (sigma_m * sigma_m)),
        Eigen::Vector3d::Constant(1.0 / (sigma_rad * sigma_rad));
    return weights.asDiagonal();
}

/// Finds loop closures between keyframes of a track, and corrects all poses with them.
class LoopCloser {
public:
    LoopCloser(const PoseTrack& track, const SubsampledScans& scans, const FitRound& first,
               const FitRound& last)
        : track_(track), scans_(scans), first_(first), maps_(first, last) {
        double driven_m = 0.0;
        for (std::size_t k = 0; k < track.pose.size(); ++k) {
            if (k > 0) driven_m += glm::distance(track.pose[k].translation, track.pose[k - 1].translation);
            path_length_m_.push_back(driven_m);
            // Keyframes are scans with points at a minimum distance along the path.
            if (!scans[k].empty() &&
                (keyframes_.empty() || driven_m >= path_length_m_[keyframes_.back()] + kKeyframeDistance_m))
                keyframes_.push_back(k);
        }
    }

    /// Searches a closure for each keyframe, and corrects the poses if there are enough.
    LoopClosureResult run_closures(const std::function<bool(double)>& proceed) {
        LoopClosureResult result{track_, 0, 0.0};
        std::optional<LoopClosure> before;
        for (std::size_t later = 0; later < keyframes_.size(); ++later) {
            if (later % 16 == 0 && !proceed(double(later) / double(keyframes_.size()))) return result;
            const std::optional<std::size_t> earlier = find_earlier(later);
            if (!earlier) continue;
            // A closure predicts the next only if it is at most 3 keyframes older.
            if (before && before->later + 3 < later) before.reset();
            if (const auto closure = find_closure(*earlier, later, before)) {
                closures_.push_back(*closure);
                before = closure;
            }
        }
        if (closures_.size() < kMinLoopClosures) return result;
        correct_poses(result);
        return result;
    }

private:
    const PoseTrack& track_;
    const SubsampledScans& scans_;
    const FitRound first_;
    std::vector<double> path_length_m_;   // [poses] length of the path up to each pose
    std::vector<std::size_t> keyframes_;  // indices of the keyframes
    std::vector<LoopClosure> closures_;
    PlaneMaps maps_;  // map around the keyframe `map_of_`
    std::optional<std::size_t> map_of_;

    const Pose& keyframe_pose(std::size_t keyframe_index) const {
        return track_.pose[keyframes_[keyframe_index]];
    }
    double path_to_keyframe_m(std::size_t keyframe_index) const {
        return path_length_m_[keyframes_[keyframe_index]];
    }

    /// Returns the nearest keyframe of an earlier pass over the same road, or nothing if
    /// all are too far away. The limit grows with the path between the two.
    std::optional<std::size_t> find_earlier(std::size_t later_keyframe_index) const {
        std::optional<std::size_t> nearest;
        double least_m = 1e30;
        for (std::size_t key = 0; key < later_keyframe_index; ++key) {
            const double path_m = path_to_keyframe_m(later_keyframe_index) - path_to_keyframe_m(key);
            if (!(path_m > kMinPassDistance_m)) break;
            const double distance_m = glm::distance(keyframe_pose(key).translation,
                                                    keyframe_pose(later_keyframe_index).translation);
            if (distance_m > std::min(kLoopDistance_m + kLoopDistanceGrowth * path_m, kMaxLoopDistance_m) ||
                distance_m >= least_m)
                continue;
            least_m = distance_m;
            nearest = key;
        }
        return nearest;
    }

    /// Builds the map of planes from the scans of all keyframes near a keyframe on the
    /// path. Keeps the current map if it already belongs to this keyframe.
    void build_map(std::size_t centre_keyframe_index) {
        if (map_of_ == centre_keyframe_index) return;
        map_of_ = centre_keyframe_index;
        maps_.clear();
        std::vector<glm::dvec3> points_m;
        for (std::size_t key = 0; key < keyframes_.size(); ++key) {
            if (std::abs(path_to_keyframe_m(key) - path_to_keyframe_m(centre_keyframe_index)) > kMapReach_m)
                continue;
            for (const SubsampledPoint& point : scans_[keyframes_[key]])
                points_m.push_back(point_to_world(track_, point).point_m);
        }
        maps_.add_points(points_m, 0.0);
    }

    /// Returns the points of a keyframe's scan in the vehicle frame of its pose, with the
    /// vehicle positions from which they were measured.
    std::vector<WorldPointWithOrigin> scan_in_keyframe(std::size_t keyframe_index) const {
        const Pose pose_from_world = inverse(keyframe_pose(keyframe_index));
        std::vector<WorldPointWithOrigin> points;
        for (const SubsampledPoint& point : scans_[keyframes_[keyframe_index]]) {
            const WorldPointWithOrigin at = point_to_world(track_, point);
            points.push_back({pose_from_world * at.point_m, pose_from_world * at.vehicle_m});
        }
        return points;
    }

    /// Returns the share of points that lie on planes of the coarsest map if the scan is
    /// at `pose`. Uses only about kGridPoints points, because many poses are tried.
    double coarse_share(const std::vector<WorldPointWithOrigin>& points, const Pose& pose) const {
        const std::size_t step = std::max<std::size_t>(1, points.size() / kGridPoints);
        std::size_t n = 0, on_planes = 0;
        for (std::size_t i = 0; i < points.size(); i += step, ++n) {
            const glm::dvec3 p = pose * points[i].point_m;
            const LocalPlane* plane = maps_.find_plane(p, 0);
            // The weight is above 1/4 if the point is closer than the kernel scale.
            on_planes +=
                plane && robust_weight(glm::dot(plane->normal, p - plane->point_m), first_.scale_m) > 0.25;
        }
        return double(on_planes) / double(std::max<std::size_t>(n, 1));
    }

    /// Returns the best start pose for an alignment. Searches a grid of positions around
    /// `initial_pose`. Score: share of points on planes of the map, minus a penalty for
    /// the distance from `initial_pose`.
    Pose find_start_pose(const std::vector<WorldPointWithOrigin>& points, const Pose& initial_pose,
                         double search_radius_m) const {
        std::vector<glm::dvec3> offsets;
        const auto steps = [&](double widest_m) {
            return int(std::ceil(std::min(search_radius_m, widest_m) / kStartGridStep_m));
        };
        const int wide = steps(kMaxStartOffset_m), high = steps(kMaxStartHeight_m);
        for (int x = -wide; x <= wide; ++x)
            for (int y = -wide; y <= wide; ++y)
                for (int z = -high; z <= high; ++z) offsets.emplace_back(x, y, z);
        const auto start_at = [&](std::size_t index) {
            return Pose{initial_pose.rotation, initial_pose.translation + kStartGridStep_m * offsets[index]};
        };
        std::vector<double> scores(offsets.size());
        parallel_for(static_cast<int>(offsets.size()), [&](int index) {
            scores[std::size_t(index)] = coarse_share(points, start_at(std::size_t(index))) -
                                         kGridPenalty * glm::length(offsets[std::size_t(index)]);
        });
        return start_at(std::size_t(std::ranges::max_element(scores) - scores.begin()));
    }

    /// Share of a scan's points on planes of the map, and motions that they do not show.
    struct MapAlignment {
        double share = 0.0;
        std::vector<UnobservedMotion> unobserved;
    };

    /// Moves a scan by one Gauss-Newton step towards planes of the map.
    /// @return length of the step
    double gauss_newton_step(const std::vector<WorldPointWithOrigin>& points, const Pose& start_pose,
                             Pose& pose, int map_level, MapAlignment& alignment) const {
        const double scale_m = maps_.settings_of_level(map_level).scale_m;
        const SinglePoseEquations equations =
            sum_point_equations(points.size(), [&](SinglePoseEquations& part, std::size_t i) {
                const glm::dvec3 p = pose * points[i].point_m;
                if (const LocalPlane* plane = maps_.find_plane(p, map_level))
                    part.add_residual(make_residual({p, pose.translation}, *plane, scale_m));
            });
        alignment = {double(equations.count_on_planes()) / double(points.size()),
                     equations.find_unobserved(min_information(true))};
        return equations.move_pose(pose, start_pose, alignment.unobserved);
    }

    /// Aligns a scan with the map, from large to small planes. Changes `pose`.
    MapAlignment refine_pose(const std::vector<WorldPointWithOrigin>& points, Pose& pose) const {
        MapAlignment alignment;
        const Pose start = pose;
        for (int level = 0; level < PlaneMaps::kLevels; ++level)
            for (int i = 0; i < kMaxLoopSteps &&
                            gauss_newton_step(points, start, pose, level, alignment) > kMinLoopStep_m;
                 ++i) {}
        return alignment;
    }

    /// Aligns the scan of a later keyframe with the map around an earlier keyframe.
    /// Returns nothing if too few points lie on planes of the map.
    std::optional<LoopClosure> find_closure(std::size_t earlier_keyframe_index,
                                            std::size_t later_keyframe_index,
                                            const std::optional<LoopClosure>& previous_closure) {
        build_map(earlier_keyframe_index);
        const std::vector<WorldPointWithOrigin> points = scan_in_keyframe(later_keyframe_index);
        // Radius of the search for a start pose: 1 m plus the expected drift of odometry.
        const double reach_m = 1.0 + kLoopDistanceGrowth * (path_to_keyframe_m(later_keyframe_index) -
                                                            path_to_keyframe_m(earlier_keyframe_index));
        const Pose& initial_pose = keyframe_pose(later_keyframe_index);
        Pose aligned_pose;
        MapAlignment alignment;
        if (previous_closure) {
            // Predicts the start pose from the previous loop closure, which corrects a
            // nearby pose. Assumes that both poses move together, like one rigid body.
            const Pose& previous_pose = keyframe_pose(previous_closure->later);
            aligned_pose =
                apply_twist(previous_pose, previous_closure->off) * inverse(previous_pose) * initial_pose;
            alignment = refine_pose(points, aligned_pose);
        }
        // Without a prediction, or if too few points match, searches for a start pose.
        if (alignment.share < kMinClosureShare) {
            aligned_pose = find_start_pose(points, initial_pose, reach_m);
            alignment = refine_pose(points, aligned_pose);
        }
        if (alignment.share < kMinClosureShare) return std::nullopt;
        const Vector6 off = to_vector(compute_twist(initial_pose, aligned_pose));
        const Matrix6 observed = observed_projection(alignment.unobserved);
        return LoopClosure{earlier_keyframe_index, later_keyframe_index, to_twist(observed * off), observed};
    }

    /// Solves for the corrections of all keyframes, 6 values each. A least-squares term
    /// gives the expected difference between the corrections of two keyframes. It is zero
    /// for odometry, and the measured correction for a loop closure.
    /// @param closure_weights [closures] robust weights, 0 to 1
    Eigen::VectorXd solve_corrections(const std::vector<double>& closure_weights) const {
        const auto n = Eigen::Index(keyframes_.size());
        std::vector<Eigen::Triplet<double>> entries;
        Eigen::VectorXd g = Eigen::VectorXd::Zero(6 * n);
        const auto add_block = [&](std::size_t block_row, std::size_t block_column, const Matrix6& matrix) {
            for (int row = 0; row < 6; ++row)
                for (int column = 0; column < 6; ++column)
                    if (matrix(row, column) != 0.0)
                        entries.emplace_back(int(6 * block_row) + row, int(6 * block_column) + column,
                                             matrix(row, column));
        };
        // The residual of a term is x_second - T x_first - expected_difference. T
        // transfers the correction of a rigid body from the first position to the second.
        const auto add_term = [&](std::size_t first, std::size_t second, const Twist& expected_difference,
                                  const Matrix6& weights) {
            // Jacobians of the residual: ja = -T for x_first, jb = I for x_second.
            const Matrix6 ja =
                -twist_transfer(keyframe_pose(second).translation - keyframe_pose(first).translation);
            const Matrix6 jb = Matrix6::Identity();
            const Vector6 target = to_vector(expected_difference);
            const Matrix6 wa = weights * ja, wb = weights * jb;
            // Adds J^T W J to the matrix. Adds J^T W expected_difference to g.
            add_block(first, first, ja.transpose() * wa);
            add_block(first, second, ja.transpose() * wb);
            add_block(second, first, jb.transpose() * wa);
            add_block(second, second, jb.transpose() * wb);
            block_of(g, first) += wa.transpose() * target;
            block_of(g, second) += wb.transpose() * target;
        };
        // The error of odometry grows with the path, so a longer step has a lower weight.
        for (std::size_t k = 0; k + 1 < keyframes_.size(); ++k)
            add_term(k, k + 1, Twist{},
                     kKeyframeDistance_m / (path_to_keyframe_m(k + 1) - path_to_keyframe_m(k)) *
                         diagonal_weights(kOdometrySigma_m, kOdometrySigma_rad));
        for (std::size_t i = 0; i < closures_.size(); ++i)
            add_term(closures_[i].earlier, closures_[i].later, closures_[i].off,
                     closure_weights[i] * closures_[i].observed.transpose() *
                         diagonal_weights(kClosureSigma_m, kClosureSigma_rad) * closures_[i].observed);
        for (int i = 0; i < 6; ++i) entries.emplace_back(i, i, 1e9);  // fixes the first pose
        Eigen::SparseMatrix<double> h(6 * n, 6 * n);
        h.setFromTriplets(entries.begin(), entries.end());
        return Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>(h).solve(g);
    }

    /// Returns the correction of a pose that moves rigidly with a keyframe.
    Vector6 transfer_correction(std::size_t pose_index, std::size_t keyframe_index,
                                const Eigen::VectorXd& keyframe_corrections) const {
        return twist_transfer(track_.pose[pose_index].translation -
                              keyframe_pose(keyframe_index).translation) *
               block_of(keyframe_corrections, keyframe_index);
    }

    /// Returns the error in metres of a loop closure after the poses are corrected.
    double closure_error_m(const LoopClosure& loop_closure, const Eigen::VectorXd& corrections) const {
        const Vector6 moves =
            block_of(corrections, loop_closure.later) -
            transfer_correction(keyframes_[loop_closure.later], loop_closure.earlier, corrections);
        return (loop_closure.observed * (moves - to_vector(loop_closure.off))).head<3>().norm();
    }

    /// Corrects all poses by the loop closures. Solves several times with new robust
    /// weights, so that a closure that contradicts the others loses its influence. Leaves
    /// the track unchanged if too few closures remain.
    void correct_poses(LoopClosureResult& result) const {
        std::vector<double> closure_weights(closures_.size(), 1.0);
        Eigen::VectorXd corrections;
        for (int i = 0; i < kClosureReweightings; ++i) {
            corrections = solve_corrections(closure_weights);
            for (std::size_t k = 0; k < closures_.size(); ++k)
                closure_weights[k] =
                    robust_weight(closure_error_m(closures_[k], corrections), kClosureKernel_m);
        }
        for (std::size_t k = 0; k < closures_.size(); ++k) {
            // Below 1/4, the error of the closure is larger than kClosureKernel_m.
            if (closure_weights[k] < 0.25) continue;
            ++result.n_closures;
            const Twist& off = closures_[k].off;
            result.largest_m = std::max(result.largest_m, glm::length(glm::dvec3(off[0], off[1], off[2])));
        }
        if (result.n_closures < kMinLoopClosures) return;
        // Interpolates the corrections of the two nearest keyframes by path length.
        std::size_t key = 0;  // last keyframe up to pose k
        for (std::size_t k = 0; k < track_.pose.size(); ++k) {
            while (key + 1 < keyframes_.size() && keyframes_[key + 1] <= k) ++key;
            const std::size_t next = std::min(key + 1, keyframes_.size() - 1);
            const double length = path_to_keyframe_m(next) - path_to_keyframe_m(key);
            const double s =
                length > 0.0 ? glm::clamp((path_length_m_[k] - path_to_keyframe_m(key)) / length, 0.0, 1.0)
                             : 0.0;
            const Vector6 correction = (1.0 - s) * transfer_correction(k, key, corrections) +
                                       s * transfer_correction(k, next, corrections);
            result.track.pose[k] = apply_twist(track_.pose[k], to_twist(correction));
        }
    }
};

}  // namespace

LoopClosureResult close_loops(const PoseTrack& odometry_track, const SubsampledScans& scans,
                              const FitRound& first, const FitRound& last,
                              const std::function<bool(double done)>& proceed) {
    return LoopCloser(odometry_track, scans, first, last).run_closures(proceed);
}

}  // namespace relidar
