// SPDX-License-Identifier: Apache-2.0
// The motion of the sensor in a sweep has two constant twists, before and after the time
// of the frame, because many programs interpolate between the poses of frames. At the
// time u in turns, the twist (v, w) of a full turn gives the point
//   x = R(-w u) (p - v u)
// in the frame at its firing time. Gauss-Newton steps with Geman-McClure weights minimise
//   e = (z - z0) / rho - slope
// over the cones of all rings and the twists of all sweeps.
#include "read/scans/lattice_fit.hpp"

#include <algorithm>

#include <Eigen/Dense>

#include "base/median.hpp"
#include "read/scans/robust_line.hpp"

namespace relidar::read {
namespace {

// Nearer points are often on the vehicle, and rounded coordinates make them inaccurate.
constexpr double kMinDistance_m = 2.0;

}  // namespace

double HeadTurn::time_turns(double azimuth_rad) const {
    const double turns = (clockwise ? seam_rad - azimuth_rad : azimuth_rad - seam_rad) / kFullTurn_rad;
    return turns - std::floor(turns) + start_turns;
}

PoseTrack make_track(const PoseTrack& world_from_sensor, double time_s, double period_s) {
    const std::vector<double>& times = world_from_sensor.time_s;
    // Poses of the turn before and after the frame, and two more on each side: one for
    // the interpolation at the ends, and one because scaled times are rounded.
    const auto first = std::ranges::lower_bound(times, time_s - period_s) - times.begin(),
               last = std::ranges::upper_bound(times, time_s + period_s) - times.begin();
    const Pose frame_from_world = inverse(world_from_sensor.pose_at(time_s));
    PoseTrack track;
    for (auto i = std::max<std::ptrdiff_t>(first - 2, 0);
         i < std::min<std::ptrdiff_t>(last + 2, std::ssize(times)); ++i)
        track.append((times[std::size_t(i)] - time_s) / period_s,
                     frame_from_world * world_from_sensor.pose[std::size_t(i)]);
    return track;
}

SweepMotion twists_of(const PoseTrack& track) {
    Twist before = compute_twist({}, track.pose_at(-1.0));
    for (double& value : before) value = -value;
    return {before, compute_twist({}, track.pose_at(1.0))};
}

glm::dvec3 undo_motion(const glm::dvec3& point_m, const PoseTrack& track, double time_turns) {
    return inverse(track.pose_at(time_turns)) * point_m;
}

glm::dvec3 undo_motion(const glm::dvec3& point_m, const SweepMotion& motion, double time_turns) {
    const Twist& twist = motion[time_turns < 0.0 ? 0 : 1];
    // The rotation by the vector w is the series p + w x p + w x (w x p) / 2 + ...
    const glm::dvec3 p = point_m - time_turns * glm::dvec3(twist[0], twist[1], twist[2]),
                     w = -time_turns * glm::dvec3(twist[3], twist[4], twist[5]), first = glm::cross(w, p),
                     second = glm::cross(w, first), third = glm::cross(w, second);
    return p + first + 0.5 * second + (1.0 / 6.0) * third;
}

SweepPoints pick_points(const LidarPoints& points, std::size_t n_points, std::size_t n_rings) {
    std::vector<std::size_t> usable;
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::vec3& p = points.position_m[i];
        const bool is_first = points.return_number.empty() || points.return_number[i] == 1;
        if (is_first && points.ring[i] < n_rings && std::hypot(double(p.x), double(p.y)) > kMinDistance_m)
            usable.push_back(i);
    }
    SweepPoints picked;
    const std::size_t n = std::min(n_points, usable.size());
    for (std::size_t k = 0; k < n; ++k) {
        const std::size_t i = usable[k * usable.size() / n];
        picked.position_m.emplace_back(points.position_m[i]);
        picked.azimuth_rad.push_back(azimuth_rad_of(picked.position_m.back()));
        picked.ring.push_back(points.ring[i]);
    }
    return picked;
}

void LatticeFitter::improve(LatticeFit& fit, int n_steps, FreeValues free_values) const {
    for (int step = 0; step < n_steps; ++step) {
        const Firings firings = compute_firings(fit);
        if (fit.rings.empty()) set_median_slopes(fit, firings);
        fit.spread_rad = spread_of(fit, firings);
        apply_change(fit, solve_step(fit, firings, free_values));
    }
    fit.spread_rad = spread_of(fit, compute_firings(fit));
}

double LatticeFitter::cost(const LatticeFit& fit, double scale_rad) const {
    double sum = 0.0, n = 0.0;
    visit_errors(fit, compute_firings(fit), [&](std::size_t, std::size_t, double e) {
        sum += e * e / (e * e + scale_rad * scale_rad);
        n += 1.0;
    });
    return sum / std::max(n, 1.0);
}

LatticeFitter::Firings LatticeFitter::compute_firings(const LatticeFit& fit) const {
    Firings firings(sweeps_.size());
    for (std::size_t s = 0; s < sweeps_.size(); ++s) {
        const SweepPoints& sweep = sweeps_[s];
        firings[s].reserve(sweep.position_m.size());
        for (std::size_t i = 0; i < sweep.position_m.size(); ++i)
            firings[s].push_back(
                find_firing(sweep.position_m[i], sweep.azimuth_rad[i], fit.motions[s], fit.turn));
    }
    return firings;
}

void LatticeFitter::set_median_slopes(LatticeFit& fit, const Firings& firings) const {
    std::vector<std::vector<double>> slopes_of_ring(n_rings_);
    for (std::size_t s = 0; s < sweeps_.size(); ++s)
        for (std::size_t i = 0; i < firings[s].size(); ++i) {
            const glm::dvec3& p = firings[s][i].position_m;
            const std::size_t ring = sweeps_[s].ring[i];
            slopes_of_ring[ring].push_back(p.z / axis_distance_m(p));
        }
    fit.rings.assign(n_rings_, {.z0_m = 0.0, .slope = NAN});
    for (std::size_t r = 0; r < n_rings_; ++r)
        if (!slopes_of_ring[r].empty()) fit.rings[r].slope = compute_median(std::move(slopes_of_ring[r]));
}

template <class Visit>
void LatticeFitter::visit_errors(const LatticeFit& fit, const Firings& firings, const Visit& visit) const {
    for (std::size_t s = 0; s < sweeps_.size(); ++s)
        for (std::size_t i = 0; i < firings[s].size(); ++i)
            visit(s, i, cone_error(firings[s][i].position_m, fit.rings[sweeps_[s].ring[i]]));
}

double LatticeFitter::spread_of(const LatticeFit& fit, const Firings& firings) const {
    std::vector<double> all;
    visit_errors(fit, firings, [&](std::size_t, std::size_t, double e) {
        if (std::isfinite(e)) all.push_back(std::abs(e));
    });
    return all.empty() ? INFINITY : kMadToSigma * compute_median(std::move(all));
}

Eigen::VectorXd LatticeFitter::solve_step(const LatticeFit& fit, const Firings& firings,
                                          FreeValues free_values) const {
    constexpr std::size_t kValues = 2 + kMotionParameters;
    // of the 7 values of a point (2 of its cone, 5 of its twist), [first, end) may change
    const std::size_t first = free_values == FreeValues::motions ? 2 : 0,
                      end = free_values == FreeValues::cones ? 2 : kValues;
    const std::size_t n = motion_index(sweeps_.size(), 0);
    // Rows of values that stay the same are zero, so their change is zero, too.
    Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(Eigen::Index(n), Eigen::Index(n));
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(Eigen::Index(n));
    const double scale = 2.0 * std::max(fit.spread_rad, 1e-9);
    visit_errors(fit, firings, [&](std::size_t sweep, std::size_t i, double e) {
        const std::size_t ring = sweeps_[sweep].ring[i];
        const auto& [p, u] = firings[sweep][i];
        const double rho = axis_distance_m(p), slope = fit.rings[ring].slope;
        if (!(rho > 0.0) || !std::isfinite(e)) return;
        const double ratio = e / scale, root = 1.0 / (1.0 + ratio * ratio), weight = root * root;
        const double cos_azimuth = p.x / rho, sin_azimuth = p.y / rho, scaled = u / rho;
        // derivatives of e by the values 0 to 6: z0, slope, v.x, v.y, v.z, w.x, w.y
        const std::array<double, kValues> derivative = {-1.0 / rho,
                                                        -1.0,
                                                        scaled * slope * cos_azimuth,
                                                        scaled * slope * sin_azimuth,
                                                        -scaled,
                                                        -scaled * (p.y + slope * p.z * sin_azimuth),
                                                        scaled * (p.x + slope * p.z * cos_azimuth)};
        const std::size_t twist_row = motion_index(sweep, u < 0.0 ? 0 : 1);
        const auto row_of = [&](std::size_t value) {
            return Eigen::Index(value < 2 ? 2 * ring + value : twist_row + value - 2);
        };
        for (std::size_t a = first; a < end; ++a) {  // lower triangle of the symmetric matrix
            gradient[row_of(a)] += weight * derivative[a] * e;
            for (std::size_t b = first; b <= a; ++b)
                normal(row_of(a), row_of(b)) += weight * derivative[a] * derivative[b];
        }
    });
    if (free_values != FreeValues::cones) join_halves(fit, normal, gradient);
    // The small diagonal makes the equations solvable for values without points.
    for (Eigen::Index i = 0; i < normal.rows(); ++i) normal(i, i) += 1e-8 * normal(i, i) + 1e-12;
    return -normal.selfadjointView<Eigen::Lower>().ldlt().solve(gradient);
}

void LatticeFitter::join_halves(const LatticeFit& fit, Eigen::MatrixXd& normal,
                                Eigen::VectorXd& gradient) const {
    constexpr double kPenalty = 1e-4;
    for (std::size_t s = 0; s < sweeps_.size(); ++s)
        for (std::size_t k = 0; k < kMotionParameters; ++k) {
            const auto before = Eigen::Index(motion_index(s, 0) + k),
                       after = Eigen::Index(motion_index(s, 1) + k);
            // Adds penalty / 2 * (before - after)^2 to the cost. Only the lower triangle
            // of the symmetric matrix is used, and `after` is the larger index.
            const double penalty = kPenalty * (normal(before, before) + normal(after, after)),
                         difference = fit.motions[s][0][k] - fit.motions[s][1][k];
            normal(before, before) += penalty;
            normal(after, after) += penalty;
            normal(after, before) -= penalty;
            gradient[before] += penalty * difference;
            gradient[after] -= penalty * difference;
        }
}

void LatticeFitter::apply_change(LatticeFit& fit, const Eigen::VectorXd& change) const {
    for (std::size_t r = 0; r < n_rings_; ++r) {
        fit.rings[r].z0_m += change[Eigen::Index(2 * r)];
        fit.rings[r].slope += change[Eigen::Index(2 * r + 1)];
    }
    for (std::size_t s = 0; s < sweeps_.size(); ++s)
        for (std::size_t half = 0; half < 2; ++half) {  // before and after the time of the frame
            const std::size_t first = motion_index(s, half);
            for (std::size_t k = 0; k < kMotionParameters; ++k)
                fit.motions[s][half][k] += change[Eigen::Index(first + k)];
        }
}

}  // namespace relidar::read
