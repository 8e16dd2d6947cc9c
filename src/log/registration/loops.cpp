// SPDX-License-Identifier: Apache-2.0
#include "log/registration/loops.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <span>

#include <Eigen/SparseCholesky>

#include "log/registration/level_maps.hpp"
#include "log/registration/pose_equations.hpp"

namespace relidar {
namespace {

// Distance along the path between two key poses. Loop closures join only key poses.
constexpr double kKey_m = 4.0;
// Two passes over the same road must be this far apart along the path. Odometry has
// already aligned closer passes.
constexpr double kApart_m = 80.0;
// Two passes are joined only if they are closer than kNear_m. This limit grows by
// kNearShare per metre of path between them, up to kFarthest_m, because odometry drifts.
constexpr double kNear_m = 4.0, kNearShare = 0.01, kFarthest_m = 15.0;
// The map for a loop closure contains scans within this distance along the earlier path,
// on both sides of the key pose.
constexpr double kMap_m = 14.0;
// Spacing and extent of the grid of start positions that registration tries around the
// predicted pose.
constexpr double kGrid_m = 1.5, kWidest_m = 6.0, kHighest_m = 4.5;
// Reduces the share of matching points of a start position per grid step from the
// prediction, so that positions near the prediction are preferred.
constexpr double kGridPenalty = 0.01;
constexpr std::size_t kGridPoints = 400;
constexpr int kMostLoopSteps = 10;
constexpr double kLoopStep_m = 1e-3, kLoopPrior = 1e-4;
// A loop closure is valid if at least this share of the scan's points lies on planes of
// the earlier pass. In odometry, the share is 0.5 to 0.8.
constexpr double kLeastShare = 0.4;
constexpr std::size_t kFewestPlaces = 2;
// standard deviations of odometry errors on a path of length kKey_m
constexpr double kWay_m = 0.01, kWay_rad = 3e-4;
constexpr double kPlace_m = 0.05, kPlace_rad = 2e-3;  // standard deviations of a loop closure
// Loop closures that contradict other loop closures by much more than this lose their
// weight (robust kernel).
constexpr double kBelieved_m = 0.5;
constexpr int kReweighted = 6;

/// Loop closure: the scan at a later key pose, registered to the map of an earlier pass
/// over the same road.
struct LoopClosure {
    std::size_t earlier, later;  // indices of the key poses
    // correction of the later pose: translation, then rotation vector
    Twist off;
};

class Loops {
public:
    Loops(const PoseTrack& track, const std::vector<std::vector<ThinPoint>>& scans,
          const LoopOptions& options)
        : track_(track), scans_(scans), options_(options), maps_(options.first, options.last) {
        double way = 0.0;
        for (std::size_t k = 0; k < track.pose.size(); ++k) {
            if (k > 0) way += glm::distance(track.pose[k].translation, track.pose[k - 1].translation);
            way_m_.push_back(way);
            if (!scans[k].empty() && (keys_.empty() || way >= way_m_[keys_.back()] + kKey_m))
                keys_.push_back(k);
        }
    }

    ClosedLoops close() {
        ClosedLoops result{track_, 0, 0.0};
        std::optional<LoopClosure> before;
        for (std::size_t later = 0; later < keys_.size(); ++later) {
            if (later % 16 == 0 && !options_.proceed(double(later) / double(keys_.size()))) return result;
            const std::optional<std::size_t> earlier = find_nearest_earlier_pose(later);
            if (!earlier) continue;
            if (before && before->later + 3 < later) before.reset();
            const std::optional<LoopClosure> found = find(*earlier, later, before);
            if (!found) continue;
            places_.push_back(*found);
            before = found;
        }
        if (places_.size() < kFewestPlaces) return result;
        distribute_corrections(result);
        return result;
    }

private:
    const PoseTrack& track_;
    const std::vector<std::vector<ThinPoint>>& scans_;
    const LoopOptions& options_;
    std::vector<double> way_m_;      // [poses] length of the path up to each pose
    std::vector<std::size_t> keys_;  // indices of the key poses
    std::vector<LoopClosure> places_;
    LevelMaps maps_;  // map around the key pose `map_of_`
    std::optional<std::size_t> map_of_;

    const Pose& pose(std::size_t key) const { return track_.pose[keys_[key]]; }
    double compute_driven_length_m(std::size_t key) const { return way_m_[keys_[key]]; }

    std::optional<std::size_t> find_nearest_earlier_pose(std::size_t later) const {
        std::optional<std::size_t> nearest;
        double least_m = 1e30;
        for (std::size_t key = 0;
             key < later && compute_driven_length_m(later) - compute_driven_length_m(key) > kApart_m; ++key) {
            const double distance_m = glm::distance(pose(key).translation, pose(later).translation);
            const double near_m = std::min(
                kNear_m + kNearShare * (compute_driven_length_m(later) - compute_driven_length_m(key)),
                kFarthest_m);
            if (distance_m > near_m || distance_m >= least_m) continue;
            least_m = distance_m;
            nearest = key;
        }
        return nearest;
    }

    void build_loop_map(std::size_t centre_key) {
        if (map_of_ == centre_key) return;
        map_of_ = centre_key;
        maps_.clear();
        std::vector<glm::dvec3> points_m;
        for (std::size_t key = 0; key < keys_.size(); ++key) {
            if (std::abs(compute_driven_length_m(key) - compute_driven_length_m(centre_key)) > kMap_m)
                continue;
            for (const ThinPoint& point : scans_[keys_[key]])
                points_m.push_back(place_point_in_world(track_, point).point_m);
        }
        maps_.add(points_m, 0.0);
    }

    /// Returns the points of a scan in the frame of its key pose, each with the position
    /// of the vehicle when it was measured.
    std::vector<PlacedPoint> transform_scan_to_key_pose(std::size_t key) const {
        const Pose pose_from_world = inverse(pose(key));
        std::vector<PlacedPoint> points;
        for (const ThinPoint& point : scans_[keys_[key]]) {
            const PlacedPoint at = place_point_in_world(track_, point);
            points.push_back({pose_from_world * at.point_m, pose_from_world * at.vehicle_m});
        }
        return points;
    }

    double compute_coarse_share(const std::vector<PlacedPoint>& points, const Pose& pose) const {
        const std::size_t step = std::max<std::size_t>(1, points.size() / kGridPoints);
        std::size_t n = 0, on_planes = 0;
        for (std::size_t i = 0; i < points.size(); i += step, ++n) {
            const glm::dvec3 p = pose * points[i].point_m;
            const Plane* plane = maps_.find_finest_plane(p, 0);
            on_planes += plane && compute_weight(glm::dot(plane->normal, p - plane->point_m),
                                                 options_.first.scale_m) > 0.25;
        }
        return double(on_planes) / double(std::max<std::size_t>(n, 1));
    }

    /// Tries a grid of start positions around a pose. Returns the one with the most
    /// points on planes of the map. Positions far from the prediction get a penalty.
    Pose find_best_start(const std::vector<PlacedPoint>& points, const Pose& initial_pose,
                         double reach_m) const {
        std::vector<glm::dvec3> offsets;
        const auto steps = [&](double widest_m) {
            return int(std::ceil(std::min(reach_m, widest_m) / kGrid_m));
        };
        const int wide = steps(kWidest_m), high = steps(kHighest_m);
        for (int x = -wide; x <= wide; ++x)
            for (int y = -wide; y <= wide; ++y)
                for (int z = -high; z <= high; ++z) offsets.emplace_back(x, y, z);
        const auto start_at = [&](std::size_t index) {
            return Pose{initial_pose.rotation, initial_pose.translation + kGrid_m * offsets[index]};
        };
        std::vector<double> scores(offsets.size());
        parallel_for(static_cast<int>(offsets.size()), [&](int index) {
            scores[std::size_t(index)] = compute_coarse_share(points, start_at(std::size_t(index))) -
                                         kGridPenalty * glm::length(offsets[std::size_t(index)]);
        });
        return start_at(std::size_t(std::ranges::max_element(scores) - scores.begin()));
    }

    /// Moves a scan by one Gauss-Newton step towards the planes of the map.
    /// @return length of the step
    double align_scan_step(const std::vector<PlacedPoint>& points, Pose& pose, int level,
                           double& share) const {
        const double scale_m = maps_.round(level).scale_m;
        const RigidEquations equations =
            parallel_reduce(points.size(), kPointsOfPart, [&](std::size_t begin, std::size_t end) {
                RigidEquations part;
                for (const PlacedPoint& point : std::span(points).subspan(begin, end - begin)) {
                    const glm::dvec3 p = pose * point.point_m;
                    if (const Plane* plane = maps_.find_finest_plane(p, level))
                        part.add(make_plane_residual_row({p, pose.translation}, *plane, scale_m));
                }
                return part;
            });
        share = double(equations.count_points_on_planes()) / double(points.size());
        if (equations.empty()) return 0.0;
        const Twist x = equations.solve(kLoopPrior);
        pose = apply_twist(pose, x);
        return compute_length_m(x);
    }

    double refine_loop_pose(const std::vector<PlacedPoint>& points, Pose& pose) const {
        double share = 0.0;
        for (int level = 0; level < LevelMaps::kLevels; ++level)
            for (int i = 0; i < kMostLoopSteps && align_scan_step(points, pose, level, share) > kLoopStep_m;
                 ++i) {}
        return share;
    }

    std::optional<LoopClosure> find(std::size_t earlier, std::size_t later_key,
                                    const std::optional<LoopClosure>& previous_closure) {
        build_loop_map(earlier);
        const std::vector<PlacedPoint> points = transform_scan_to_key_pose(later_key);
        const double reach_m =
            1.0 + kNearShare * (compute_driven_length_m(later_key) - compute_driven_length_m(earlier));
        Pose at = previous_closure
                      ? apply_correction_to_other_pose(previous_closure->off, pose(previous_closure->later),
                                                       pose(later_key))
                      : find_best_start(points, pose(later_key), reach_m);
        double share = refine_loop_pose(points, at);
        // If the start value from the previous loop closure fails, tries the grid of
        // start positions.
        if (previous_closure && share < kLeastShare) {
            at = find_best_start(points, pose(later_key), reach_m);
            share = refine_loop_pose(points, at);
        }
        if (share < kLeastShare) return std::nullopt;
        return LoopClosure{earlier, later_key, compute_twist(pose(later_key), at)};
    }

    /// Applies the motion that corrects `pose` to another pose. Both poses move together
    /// like a rigid body.
    static Pose apply_correction_to_other_pose(const Twist& correction, const Pose& pose,
                                               const Pose& other_pose) {
        const Pose world_from_world = apply_twist(pose, correction) * inverse(pose);
        return world_from_world * other_pose;
    }

    /// Least-squares equations for the corrections x of all key poses. add() adds a term
    /// that pulls x_b to x_a (converted to pose b) plus `off`.
    struct Equations {
        std::vector<Eigen::Triplet<double>> h;
        Eigen::VectorXd g;

        void add(std::size_t first, std::size_t second, const glm::dvec3& from_a_to_b,
                 const Twist& difference, const Vector6& weight) {
            const Matrix6 ja = -make_motion_matrix(from_a_to_b);
            const Matrix6 jb = Matrix6::Identity();
            const Vector6 target = Eigen::Map<const Vector6>(difference.data());
            const auto block = [&](std::size_t index, std::size_t j, const Matrix6& matrix) {
                for (int r = 0; r < 6; ++r)
                    for (int c = 0; c < 6; ++c)
                        if (matrix(r, c) != 0.0)
                            h.emplace_back(int(6 * index) + r, int(6 * j) + c, matrix(r, c));
            };
            const Matrix6 wa = weight.asDiagonal() * ja, wb = weight.asDiagonal() * jb;
            block(first, first, ja.transpose() * wa);
            block(first, second, ja.transpose() * wb);
            block(second, first, jb.transpose() * wa);
            block(second, second, jb.transpose() * wb);
            g.segment<6>(6 * Eigen::Index(first)) += wa.transpose() * target;
            g.segment<6>(6 * Eigen::Index(second)) += wb.transpose() * target;
        }
    };

    static Vector6 make_prior_weights(double metres, double radians, double factor) {
        Vector6 w;
        w << Eigen::Vector3d::Constant(factor / (metres * metres)),
            Eigen::Vector3d::Constant(factor / (radians * radians));
        return w;
    }

    Eigen::VectorXd solve(const std::vector<double>& believed) const {
        const std::size_t n = keys_.size();
        Equations equations{{}, Eigen::VectorXd::Zero(6 * Eigen::Index(n))};
        const auto between_keys = [&](std::size_t first, std::size_t second) {
            return pose(second).translation - pose(first).translation;
        };
        for (std::size_t k = 0; k + 1 < n; ++k)
            equations.add(
                k, k + 1, between_keys(k, k + 1), Twist{},
                make_prior_weights(kWay_m, kWay_rad,
                                   kKey_m / (compute_driven_length_m(k + 1) - compute_driven_length_m(k))));
        for (std::size_t i = 0; i < places_.size(); ++i)
            equations.add(places_[i].earlier, places_[i].later,
                          between_keys(places_[i].earlier, places_[i].later), places_[i].off,
                          make_prior_weights(kPlace_m, kPlace_rad, believed[i]));
        for (int i = 0; i < 6; ++i) equations.h.emplace_back(i, i, 1e9);  // fixes the first pose
        Eigen::SparseMatrix<double> h(6 * Eigen::Index(n), 6 * Eigen::Index(n));
        h.setFromTriplets(equations.h.begin(), equations.h.end());
        return Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>(h).solve(equations.g);
    }

    /// Returns the correction of a pose that moves with a corrected key pose like a rigid
    /// body.
    Vector6 move_with_key_pose(std::size_t index, std::size_t key, const Eigen::VectorXd& solution) const {
        return make_motion_matrix(track_.pose[index].translation - pose(key).translation) *
               solution.segment<6>(6 * Eigen::Index(key));
    }

    /// Returns by how many metres a loop closure still disagrees with the corrected key
    /// poses.
    double compute_contradiction_m(const LoopClosure& place, const Eigen::VectorXd& solution) const {
        const Vector6 moves = solution.segment<6>(6 * Eigen::Index(place.later)) -
                              move_with_key_pose(keys_[place.later], place.earlier, solution);
        return (moves.head<3>() - Eigen::Vector3d(place.off[0], place.off[1], place.off[2])).norm();
    }

    void distribute_corrections(ClosedLoops& result) const {
        std::vector<double> believed(places_.size(), 1.0);
        Eigen::VectorXd x;
        for (int i = 0; i < kReweighted; ++i) {
            x = solve(believed);
            for (std::size_t k = 0; k < places_.size(); ++k)
                believed[k] = compute_weight(compute_contradiction_m(places_[k], x), kBelieved_m);
        }
        for (std::size_t k = 0; k < places_.size(); ++k) {
            if (believed[k] < 0.25) continue;
            ++result.places;
            const Twist& off = places_[k].off;
            result.largest_m = std::max(result.largest_m, glm::length(glm::dvec3(off[0], off[1], off[2])));
        }
        if (result.places < kFewestPlaces) return;
        std::size_t key = 0;
        for (std::size_t k = 0; k < track_.pose.size(); ++k) {
            while (key + 1 < keys_.size() && keys_[key + 1] <= k) ++key;
            const std::size_t next = std::min(key + 1, keys_.size() - 1);
            const double length = compute_driven_length_m(next) - compute_driven_length_m(key);
            const double s = length > 0.0
                                 ? glm::clamp((way_m_[k] - compute_driven_length_m(key)) / length, 0.0, 1.0)
                                 : 0.0;
            const Vector6 c = (1.0 - s) * move_with_key_pose(k, key, x) + s * move_with_key_pose(k, next, x);
            result.track.pose[k] = apply_twist(track_.pose[k], {c[0], c[1], c[2], c[3], c[4], c[5]});
        }
    }
};

}  // namespace

ClosedLoops close_loops(const PoseTrack& followed, const std::vector<std::vector<ThinPoint>>& scans,
                        const LoopOptions& options) {
    return Loops(followed, scans, options).close();
}

}  // namespace relidar
