// SPDX-License-Identifier: Apache-2.0
#include "log/registration/plane_adjustment.hpp"

#include <algorithm>
#include <cmath>
#include <span>

#include "base/parallel.hpp"
#include "log/registration/pose_equations.hpp"

namespace relidar {
namespace {

// Number of partial sums. It is fixed, so that the result does not depend on the number
// of threads.
constexpr int kChunks = 64;
// number of rounds in which the cells become smaller, and of further rounds with the
// smallest cells
constexpr int kShrinking = 8, kLastRounds = 2;
constexpr double kShift = 0.37;  // Shift of the cell grid from one round to the next, in cells.
// Weight of the prior that pulls corrections to zero, relative to the mean weight of the
// points. It matters only in directions that no point constrains.
constexpr double kAdjustmentPrior = 1e-4;
constexpr std::size_t kFewestPlaced = 30;
// A pose is lost if a smaller share of its points lies on planes. The share is 0.3 to 0.7
// in streets, and 0.003 for random ranges.
constexpr double kFewestOnPlanes = 0.05;

/// Splits [0, count) into kChunks parts, and calls task(begin, end, chunk) in parallel.
template <class Task>
void run_in_chunks(std::size_t count, const Task& task) {
    const std::size_t size = count / kChunks + 1;
    parallel_for(kChunks, [&](int c) {
        task(std::min(count, std::size_t(c) * size), std::min(count, (std::size_t(c) + 1) * size),
             std::size_t(c));
    });
}

std::vector<PlacedPoint> transform_points_to_world(const PoseTrack& track,
                                                   const std::vector<ThinPoint>& points) {
    std::vector<PlacedPoint> placed(points.size());
    run_in_chunks(points.size(), [&](std::size_t begin, std::size_t end, std::size_t) {
        for (std::size_t i = begin; i < end; ++i) placed[i] = place_point_in_world(track, points[i]);
    });
    return placed;
}

Twist extract_twist(const Eigen::VectorXd& step, std::size_t pose) {
    Twist twist;
    for (std::size_t i = 0; i < 6; ++i) twist[i] = step[Eigen::Index(6 * pose + i)];
    return twist;
}

Eigen::VectorXd compute_pose_differences(const PoseTrack& first, const PoseTrack& second) {
    Eigen::VectorXd result(6 * Eigen::Index(first.pose.size()));
    for (std::size_t k = 0; k < first.pose.size(); ++k) {
        const Twist twist = compute_twist(first.pose[k], second.pose[k]);
        for (std::size_t i = 0; i < 6; ++i) result[Eigen::Index(6 * k + i)] = twist[i];
    }
    return result;
}

/// Fits a plane in each cell with points from at least two sweeps.
std::vector<std::optional<Plane>> fit_planes(const PlaneCells& cells, const std::vector<ThinPoint>& points,
                                             const std::vector<PlacedPoint>& placed,
                                             const RegisterRound& round) {
    std::vector<std::optional<Plane>> planes(cells.size());
    run_in_chunks(cells.size(), [&](std::size_t begin, std::size_t end, std::size_t) {
        for (std::size_t c = begin; c < end; ++c) {
            const std::span<const std::uint32_t> members = cells.members(c);
            if (points[members.front()].pose != points[members.back()].pose)
                planes[c] = fit_plane(placed, members, round.cell_m, round.scale_m);
        }
    });
    return planes;
}

}  // namespace

const Plane* PlaneMap::at(const glm::dvec3& point_m) const {
    const std::optional<std::size_t> cell = cells.find(point_m);
    return cell && planes[*cell] ? &*planes[*cell] : nullptr;
}

PlaneAdjustment::PlaneAdjustment(const PoseTrack& initial_track, const PoseTrack& start,
                                 std::vector<ThinPoint> points, std::vector<bool> gauge)
    : given_(initial_track), track_(start), points_(std::move(points)), gauge_(std::move(gauge)) {
    remove_common_motion();
    start_ = track_;
}

std::vector<RegisterRound> PlaneAdjustment::run(const RegisterRound& first, const RegisterRound& last,
                                                const std::function<bool(double done)>& proceed) {
    constexpr int kRounds = kShrinking + kLastRounds;
    std::vector<RegisterRound> rounds;
    for (int i = 0; i < kRounds && proceed(i / double(kRounds)); ++i)
        rounds.push_back(
            step(interpolate_rounds(first, last, std::min(1.0, i / double(kShrinking - 1))), kShift * i));
    return rounds;
}

PlaneMap PlaneAdjustment::planes(const RegisterRound& round) const {
    const std::vector<PlacedPoint> placed = transform_points_to_world(track_, points_);
    PlaneMap map{PlaneCells(placed, round.cell_m, 0.0), {}};
    map.planes = fit_planes(map.cells, points_, placed, round);
    return map;
}

RegisterRound PlaneAdjustment::step(RegisterRound round, double shift) {
    const std::vector<PlacedPoint> placed = transform_points_to_world(track_, points_);
    const PlaneCells cells(placed, round.cell_m, shift);
    const std::vector<std::optional<Plane>> planes = fit_planes(cells, points_, placed, round);
    std::vector<PoseEquations> parts(kChunks, PoseEquations(track_.pose.size()));
    run_in_chunks(cells.size(), [&](std::size_t begin, std::size_t end, std::size_t chunk) {
        for (std::size_t c = begin; c < end; ++c)
            if (planes[c])
                parts[chunk].add_cell_residuals(points_, placed, cells.members(c), *planes[c], round.scale_m);
    });
    for (std::size_t c = 1; c < kChunks; ++c) parts[0].add(std::move(parts[c]));
    if (prior_) add_prior(parts[0]);
    const PoseTrack before = track_;
    const Eigen::VectorXd step =
        parts[0].solve(track_, compute_pose_differences(start_, track_), kAdjustmentPrior);
    for (std::size_t k = 0; k < track_.pose.size(); ++k)
        track_.pose[k] = apply_twist(track_.pose[k], extract_twist(step, k));
    remove_common_motion();
    round.planes = parts[0].n_planes();
    round.residual_m = parts[0].residual_m();
    for (std::size_t k = 0; k < track_.pose.size(); ++k)
        round.step_m =
            std::max(round.step_m, glm::length(track_.pose[k].translation - before.pose[k].translation));
    return round;
}

void PlaneAdjustment::add_prior(PoseEquations& equations) const {
    constexpr double kLinkTime_s = 0.1;
    const Eigen::VectorXd correction = compute_pose_differences(start_, track_);
    const auto of_pose = [&](std::size_t index) -> Vector6 {
        return correction.segment<6>(6 * Eigen::Index(index));
    };
    for (std::size_t k = 0; k < track_.pose.size(); ++k) {
        equations.add_zero_correction_prior(k, prior_->pull, of_pose(k));
        if (k + 1 == track_.pose.size()) break;
        const double share = kLinkTime_s / (track_.time_s[k + 1] - track_.time_s[k]);
        equations.add_neighbour_pose_prior(k, share * prior_->link, of_pose(k + 1) - of_pose(k));
    }
}

void PlaneAdjustment::remove_common_motion() {
    const auto n = double(std::count(gauge_.begin(), gauge_.end(), true));
    // Removing a mean of rotation vectors is only approximate, so it is repeated three
    // times.
    for (int i = 0; i < 3; ++i) {
        glm::dvec3 centre(0.0), v(0.0), w(0.0);
        for (std::size_t k = 0; k < track_.pose.size(); ++k) {
            if (!gauge_[k]) continue;
            const Twist c = compute_twist(given_.pose[k], track_.pose[k]);
            centre += given_.pose[k].translation / n;
            v += glm::dvec3(c[0], c[1], c[2]) / n;
            w += glm::dvec3(c[3], c[4], c[5]) / n;
        }
        const glm::dquat turn = apply_twist(Pose{}, {0, 0, 0, -w.x, -w.y, -w.z}).rotation;
        for (Pose& pose : track_.pose)
            pose = {glm::normalize(turn * pose.rotation), centre + turn * (pose.translation - v - centre)};
    }
}

std::pair<std::size_t, std::size_t> PlaneAdjustment::find_neighbour_poses(std::size_t pose,
                                                                          const std::vector<bool>& selected) {
    std::size_t before = pose, after = pose;
    for (std::size_t k = pose; k-- > 0 && before == pose;)
        if (selected[k]) before = k;
    for (std::size_t k = pose + 1; k < selected.size() && after == pose; ++k)
        if (selected[k]) after = k;
    return {before, after};
}

double PlaneAdjustment::compute_time_fraction(std::size_t before, std::size_t pose, std::size_t after) const {
    const std::vector<double>& t = given_.time_s;
    return (t[pose] - t[before]) / (t[after] - t[before]);
}

void PlaneAdjustment::interpolate_corrections(const std::vector<bool>& is_known) {
    const Eigen::VectorXd known = compute_pose_differences(start_, track_);
    for (std::size_t k = 0; k < is_known.size(); ++k) {
        if (is_known[k]) continue;
        auto [before, after] = find_neighbour_poses(k, is_known);
        if (before == k && after == k) continue;  // no known pose exists
        if (before == k) before = after;
        if (after == k) after = before;
        const double s = before == after ? 0.0 : compute_time_fraction(before, k, after);
        Twist twist = extract_twist(known, before);
        for (std::size_t i = 0; i < 6; ++i) twist[i] += s * (extract_twist(known, after)[i] - twist[i]);
        track_.pose[k] = apply_twist(start_.pose[k], twist);
    }
}

double PlaneAdjustment::compute_fraction_on_planes(const PlaneMap& map, std::span<const ThinPoint> points,
                                                   double scale_m) const {
    std::size_t n_placed = 0;
    for (const ThinPoint& point : points) {
        const PlacedPoint placed = place_point_in_world(track_, point);
        const Plane* plane = map.at(placed.point_m);
        n_placed += plane && make_plane_residual_row(placed, *plane, scale_m).is_on_plane();
    }
    return points.empty() ? 0.0 : double(n_placed) / double(points.size());
}

bool PlaneAdjustment::is_placed(double share, std::size_t n_points) {
    return share >= kFewestOnPlanes && share * double(n_points) >= double(kFewestPlaced);
}

double PlaneAdjustment::compute_deviation_m(std::size_t pose, const std::vector<bool>& selected) const {
    const auto [before, after] = find_neighbour_poses(pose, selected);
    if (before == pose || after == pose) return 0.0;
    const auto correction = [&](std::size_t index) {
        return track_.pose[index].translation - given_.pose[index].translation;
    };
    const glm::dvec3 between =
        glm::mix(correction(before), correction(after), compute_time_fraction(before, pose, after));
    // If the given poses jump, one of the neighbours has the same jump. The minimum over
    // both neighbours ignores it.
    double least = glm::distance(correction(pose), between);
    for (const std::size_t neighbour : {before, after})
        least = std::min(least, glm::distance(correction(pose), correction(neighbour)));
    return least;
}

std::vector<std::size_t> PlaneAdjustment::replace_lost_poses(const PlaneMap& map,
                                                             const std::vector<bool>& candidates,
                                                             double scale_m, double largest_m) {
    std::vector<std::span<const ThinPoint>> scans(candidates.size());
    for (std::size_t k = 0, begin = 0, end = 0; k < scans.size(); ++k, begin = end) {
        while (end < points_.size() && points_[end].pose == k) ++end;
        scans[k] = std::span(points_).subspan(begin, end - begin);
    }
    std::vector<double> shares(scans.size());
    parallel_for(static_cast<int>(scans.size()), [&](int k) {
        shares[std::size_t(k)] = compute_fraction_on_planes(map, scans[std::size_t(k)], scale_m);
    });
    std::vector<std::size_t> lost;
    std::vector<bool> is_known = candidates;
    for (std::size_t k = 0; k < is_known.size(); ++k) {
        if (!candidates[k] ||
            (is_placed(shares[k], scans[k].size()) && compute_deviation_m(k, candidates) <= largest_m))
            continue;
        lost.push_back(k);
        is_known[k] = false;
    }
    interpolate_corrections(is_known);
    return lost;
}

void PlaneAdjustment::align_pose_to_planes(const PlaneMap& map, std::size_t pose,
                                           const std::vector<ThinPoint>& points, double scale_m) {
    const RigidEquations equations =
        parallel_reduce(points.size(), kPointsOfPart, [&](std::size_t begin, std::size_t end) {
            RigidEquations part;
            for (const ThinPoint& point : std::span(points).subspan(begin, end - begin)) {
                const PlacedPoint placed = place_point_in_world(track_, point);
                if (const Plane* plane = map.at(placed.point_m))
                    part.add(make_plane_residual_row(placed, *plane, scale_m), get_pose_share(point, pose));
            }
            return part;
        });
    if (!equations.empty())
        track_.pose[pose] = apply_twist(track_.pose[pose], equations.solve(kAdjustmentPrior));
}

}  // namespace relidar
