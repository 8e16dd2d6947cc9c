// SPDX-License-Identifier: Apache-2.0
// Fits a smoothing spline to noisy positions. The spline is the mean of a random walk
// with white noise on the jerk. A Kalman filter runs forward, and a Rauch-Tung-Striebel
// smoother runs backward:
//   state = (p, v, a)
//   F = [1 dt dt^2/2; 0 1 dt; 0 0 1]
//   Q = q [dt^5/20 dt^4/8 dt^3/6; dt^4/8 dt^3/3 dt^2/2; dt^3/6 dt^2/2 dt]
#include "scene/movers/mover_tracks.hpp"

#include <algorithm>
#include <cmath>

namespace relidar {
namespace {

constexpr double kPositionNoise_m = 0.1;  // standard deviation of an observed position
// Spectral density q of the white noise on the jerk, m^2/s^5. With a position every 0.1
// s, the path follows motions that take longer than 0.4 s and smooths shorter motions.
constexpr double kJerkDensity = 0.2;
constexpr double kFarFromPath_m = 0.3;  // a position at this distance from the path has half the weight
constexpr int kPathRounds = 3;
// The heading at a position is the direction of a chord of the path. The chord begins at
// this distance before the position and ends at this distance after it.
constexpr double kHeadingChord_m = 1.5;
// A path through a, p and b turns back at p if |ab| / max(|ap|, |pb|) is below this
// ratio. The heading at p is then the direction from a to p instead of from a to b.
constexpr double kMinChordRatio = 0.3;

/// State (p, v, a) of each world axis, in the columns of `state`, and its covariance,
/// which all axes share, because their noise is the same.
struct KalmanState {
    glm::dmat3 state{0.0}, covariance{0.0};
};

glm::dmat3 transition(double dt_s) { return {1.0, 0.0, 0.0, dt_s, 1.0, 0.0, 0.5 * dt_s * dt_s, dt_s, 1.0}; }

glm::dmat3 process_noise(double dt_s) {
    const double d2 = dt_s * dt_s, d3 = d2 * dt_s, d4 = d3 * dt_s;
    return kJerkDensity * glm::dmat3(d4 * dt_s / 20.0, d4 / 8.0, d3 / 6.0, d4 / 8.0, d3 / 3.0, d2 / 2.0,
                                     d3 / 6.0, d2 / 2.0, dt_s);
}

/// Corrects a predicted state with an observed position:
///   state += gain (observed - predicted position), covariance -= gain (P h)^T
///   gain = P h / (h^T P h + noise^2 / weight), where h = (1, 0, 0) and P = covariance
KalmanState correct_state(KalmanState state, const glm::dvec3& observed_m, double weight) {
    const glm::dvec3 column = state.covariance[0];  // P h
    const glm::dvec3 gain = column / (column.x + kPositionNoise_m * kPositionNoise_m / weight);
    for (int axis = 0; axis < 3; ++axis)
        state.state[axis] += gain * (observed_m[axis] - state.state[axis][0]);
    state.covariance -= glm::outerProduct(gain, column);
    return state;
}

KalmanState predict_state(const KalmanState& previous, double dt_s) {
    const glm::dmat3 f = transition(dt_s);
    return {f * previous.state, f * previous.covariance * glm::transpose(f) + process_noise(dt_s)};
}

/// Estimates position, velocity and acceleration at each time: runs a Kalman filter over
/// the positions, and a smoother back from the last position.
/// @param weights [times] weight of each observed position, 0 to 1
KinematicPath run_smoother(const std::vector<double>& times_s, const std::vector<glm::dvec3>& positions_m,
                           const std::vector<double>& weights) {
    const std::size_t n = times_s.size();
    std::vector<KalmanState> predicted(n), filtered(n);  // before and after each observed position
    // Nothing is known before the first position, so all variances are large.
    predicted[0].covariance = glm::dmat3(1e3, 0.0, 0.0, 0.0, 1e3, 0.0, 0.0, 0.0, 10.0);
    for (int axis = 0; axis < 3; ++axis) predicted[0].state[axis][0] = positions_m[0][axis];
    for (std::size_t k = 0; k < n; ++k) {
        if (k > 0) predicted[k] = predict_state(filtered[k - 1], times_s[k] - times_s[k - 1]);
        filtered[k] = correct_state(predicted[k], positions_m[k], weights[k]);
    }
    // The smoother corrects each state by what the later positions tell about it:
    // state = filtered + back (next state - next prediction), back = P F^T (next P)^-1.
    std::vector<glm::dmat3> states(n);
    for (std::size_t k = 0; k < n; ++k) states[k] = filtered[k].state;
    for (std::size_t k = n - 1; k-- > 0;) {
        const glm::dmat3 back = filtered[k].covariance *
                                glm::transpose(transition(times_s[k + 1] - times_s[k])) *
                                glm::inverse(predicted[k + 1].covariance);
        states[k] += back * (states[k + 1] - predicted[k + 1].state);
    }
    KinematicPath path;
    for (const glm::dmat3& state : states) {
        const glm::dmat3 rows = glm::transpose(state);  // position, velocity, acceleration
        path.push_back({rows[0], rows[1], rows[2]});
    }
    return path;
}

/// Returns the first point of the path at the distance kHeadingChord_m from one of its
/// positions, or the end of the path. Interpolates between the positions.
/// @param index_step 1 to search forward, -1 to search backward
glm::dvec2 find_chord_end(const std::vector<glm::dvec3>& path_m, std::size_t start_index, int index_step) {
    const glm::dvec2 here(path_m[start_index]);
    glm::dvec2 last = here;
    for (auto k = std::ptrdiff_t(start_index) + index_step; k >= 0 && k < std::ptrdiff_t(path_m.size());
         k += index_step) {
        const glm::dvec2 next(path_m[std::size_t(k)]);
        const double last_m = glm::distance(here, last), next_m = glm::distance(here, next);
        if (next_m >= kHeadingChord_m)
            return glm::mix(last, next, (kHeadingChord_m - last_m) / std::max(next_m - last_m, 1e-9));
        last = next;
    }
    return last;
}

}  // namespace

KinematicPath smooth_path(const std::vector<double>& times_s, const std::vector<glm::dvec3>& positions_m) {
    std::vector<double> weights(times_s.size(), 1.0);
    KinematicPath path;
    // Iteratively reweighted least squares with w = 1 / (1 + (d / kFarFromPath_m)^2),
    // where d is the horizontal distance from the path of this round.
    for (int round = 0; round < kPathRounds; ++round) {
        path = run_smoother(times_s, positions_m, weights);
        for (std::size_t k = 0; k < path.size(); ++k) {
            const double d_m = glm::length(glm::dvec2(positions_m[k] - path[k].position_m));
            const double relative = d_m / kFarFromPath_m;
            weights[k] = 1.0 / (1.0 + relative * relative);
        }
    }
    return path;
}

std::vector<double> path_headings_rad(const std::vector<glm::dvec3>& path_m) {
    std::vector<double> result;
    for (std::size_t k = 0; k < path_m.size(); ++k) {
        const glm::dvec2 from = find_chord_end(path_m, k, -1), here(path_m[k]);
        glm::dvec2 to = find_chord_end(path_m, k, 1);
        // If the path turns back here, the short chord gives no direction.
        if (glm::distance(from, to) <
            kMinChordRatio * std::max(glm::distance(from, here), glm::distance(here, to)))
            to = here;
        result.push_back(std::atan2(to.y - from.y, to.x - from.x));
    }
    return result;
}

}  // namespace relidar
