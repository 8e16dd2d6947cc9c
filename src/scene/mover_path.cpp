// SPDX-License-Identifier: Apache-2.0
// Fits a smoothing spline to noisy positions. The spline is the mean of a random walk
// with white noise on the jerk. A Kalman filter runs forward, and a Rauch-Tung-Striebel
// smoother runs backward:
//   state = (p, v, a)
//   F = [1 dt dt^2/2; 0 1 dt; 0 0 1]
//   Q = q [dt^5/20 dt^4/8 dt^3/6; dt^4/8 dt^3/3 dt^2/2; dt^3/6 dt^2/2 dt]
#include "scene/mover_path.hpp"

#include <algorithm>
#include <cmath>

namespace relidar {
namespace {

// standard deviation of the observed position of an object's near end
constexpr double kPlaceNoise_m = 0.1;
// Noise density q of the jerk, m^2/s^5. With one position every 0.1 s, the path follows
// motions that take longer than 0.4 s and smooths shorter motions.
constexpr double kJerk = 0.2;
// A position at this distance from the path has half the weight of a position on the
// path.
constexpr double kFarFromPath_m = 0.3;
constexpr int kPathRounds = 3;
// The heading is the direction of a chord. The chord reaches this far along the path in
// each direction. An error of 3 cm at both ends rotates the chord by less than a degree.
constexpr double kChord_m = 1.5;
// If the chord is shorter than this share of its longer half, the path turns back. Then
// only the earlier half of the chord gives the heading.
constexpr double kTurnsBack = 0.3;

/// State of the Kalman filter. Each column is a world axis. The rows are position,
/// velocity and acceleration.
struct Estimate {
    glm::dmat3 state{0.0};
    glm::dmat3 covariance{0.0};
};

glm::dmat3 make_transition_matrix(double dt) { return {1.0, 0.0, 0.0, dt, 1.0, 0.0, 0.5 * dt * dt, dt, 1.0}; }

glm::dmat3 make_jerk_noise(double dt) {
    const double d2 = dt * dt, d3 = d2 * dt, d4 = d3 * dt;
    return kJerk * glm::dmat3(d4 * dt / 20.0, d4 / 8.0, d3 / 6.0, d4 / 8.0, d3 / 3.0, d2 / 2.0, d3 / 6.0,
                              d2 / 2.0, dt);
}

Estimate predict_state(const Estimate& state, double dt) {
    const glm::dmat3 f = make_transition_matrix(dt);
    return {f * state.state, f * state.covariance * glm::transpose(f) + make_jerk_noise(dt)};
}

void correct(Estimate& estimate, const glm::dvec3& place_m, double weight) {
    const glm::dvec3 column = estimate.covariance[0];
    const glm::dvec3 gain = column / (column.x + kPlaceNoise_m * kPlaceNoise_m / weight);
    for (int axis = 0; axis < 3; ++axis)
        estimate.state[axis] += gain * (place_m[axis] - estimate.state[axis][0]);
    estimate.covariance -= glm::outerProduct(gain, column);
}

std::vector<PathState> smooth_path_once(const std::vector<double>& time_s,
                                        const std::vector<glm::dvec3>& place_m,
                                        const std::vector<double>& weights) {
    const std::size_t n = time_s.size();
    std::vector<Estimate> filtered(n), before(n);
    before[0].covariance = glm::dmat3(1e3, 0.0, 0.0, 0.0, 1e3, 0.0, 0.0, 0.0, 10.0);
    for (int axis = 0; axis < 3; ++axis) before[0].state[axis][0] = place_m[0][axis];
    for (std::size_t k = 0; k < n; ++k) {
        if (k > 0) before[k] = predict_state(filtered[k - 1], time_s[k] - time_s[k - 1]);
        filtered[k] = before[k];
        correct(filtered[k], place_m[k], weights[k]);
    }
    std::vector<PathState> path(n);
    glm::dmat3 state = filtered[n - 1].state;
    for (std::size_t k = n; k-- > 0;) {
        if (k + 1 < n) {
            const glm::dmat3 back = filtered[k].covariance *
                                    glm::transpose(make_transition_matrix(time_s[k + 1] - time_s[k])) *
                                    glm::inverse(before[k + 1].covariance);
            state = filtered[k].state + back * (state - before[k + 1].state);
        }
        const glm::dmat3 rows = glm::transpose(state);
        path[k] = {rows[0], rows[1], rows[2]};
    }
    return path;
}

/// Walks along the path from one of its positions. Returns the first point at the
/// distance kChord_m, or the end of the path.
/// @param step 1 for later positions, -1 for earlier positions
glm::dvec2 find_chord_end(const std::vector<glm::dvec3>& path_m, std::size_t place, int step) {
    const glm::dvec2 here(path_m[place]);
    glm::dvec2 last = here;
    for (auto k = std::ptrdiff_t(place) + step; k >= 0 && k < std::ptrdiff_t(path_m.size()); k += step) {
        const glm::dvec2 next(path_m[std::size_t(k)]);
        const double near_m = glm::distance(here, last), far_m = glm::distance(here, next);
        if (far_m >= kChord_m)
            return glm::mix(last, next, (kChord_m - near_m) / std::max(far_m - near_m, 1e-9));
        last = next;
    }
    return last;
}

}  // namespace

std::vector<PathState> smooth_path(const std::vector<double>& time_s,
                                   const std::vector<glm::dvec3>& place_m) {
    std::vector<double> weights(time_s.size(), 1.0);
    std::vector<PathState> path;
    for (int round = 0; round < kPathRounds; ++round) {
        path = smooth_path_once(time_s, place_m, weights);
        for (std::size_t k = 0; k < path.size(); ++k) {
            const double off = glm::length(glm::dvec2(place_m[k] - path[k].position_m)) / kFarFromPath_m;
            weights[k] = 1.0 / (1.0 + off * off);
        }
    }
    return path;
}

std::vector<double> compute_headings_along(const std::vector<glm::dvec3>& path_m) {
    std::vector<double> result;
    for (std::size_t k = 0; k < path_m.size(); ++k) {
        const glm::dvec2 from = find_chord_end(path_m, k, -1), here(path_m[k]);
        glm::dvec2 to = find_chord_end(path_m, k, 1);
        if (glm::distance(from, to) <
            kTurnsBack * std::max(glm::distance(from, here), glm::distance(here, to)))
            to = here;
        result.push_back(std::atan2(to.y - from.y, to.x - from.x));
    }
    return result;
}

}  // namespace relidar
