// SPDX-License-Identifier: Apache-2.0
// Implements the Adam optimizer (Kingma and Ba 2015) for a few poses, on the host. The
// second moment decays faster than usual, because each pose gets only tens of gradients.
#include "train/poses/track_correction.hpp"

#include <algorithm>
#include <cmath>

namespace relidar {
namespace {

constexpr double kBeta1 = 0.9, kBeta2 = 0.99, kEpsilon = 1e-15;

glm::dvec3 three_components(const Twist& twist, std::size_t first_index) {
    return {twist[first_index], twist[first_index + 1], twist[first_index + 2]};
}

}  // namespace

TrackCorrection::TrackCorrection(PoseTrack track)
    : track_(std::move(track)),
      values_(6 * track_.pose.size(), 0.0),
      moment1_(values_),
      moment2_(values_),
      n_steps_(track_.pose.size(), 0),
      gradient_(values_),
      visited_(track_.pose.size(), false) {}

Twist TrackCorrection::stored_correction(std::size_t pose_index) const {
    Twist twist;
    std::copy_n(values_.begin() + std::ptrdiff_t(6 * pose_index), 6, twist.begin());
    return twist;
}

Twist TrackCorrection::correction_at(std::size_t pose_index) const {
    const auto is_corrected = [this](std::size_t index) { return n_steps_[index] > 0; };
    std::size_t before = pose_index, after = pose_index;
    while (before > 0 && !is_corrected(before)) --before;
    while (after + 1 < n_steps_.size() && !is_corrected(after)) ++after;
    if (!is_corrected(before) && !is_corrected(after)) return {};
    if (before == after || !is_corrected(after)) return stored_correction(before);
    if (!is_corrected(before)) return stored_correction(after);
    const double s =
        (track_.time_s[pose_index] - track_.time_s[before]) / (track_.time_s[after] - track_.time_s[before]);
    Twist twist;
    for (std::size_t i = 0; i < 6; ++i)
        twist[i] = (1.0 - s) * stored_correction(before)[i] + s * stored_correction(after)[i];
    return twist;
}

PoseTrack TrackCorrection::corrected_track() const {
    PoseTrack result = track_;
    for (std::size_t k = 0; k < result.pose.size(); ++k)
        result.pose[k] = apply_twist(track_.pose[k], correction_at(k));
    return result;
}

void TrackCorrection::add_gradient(double t_s, const Twist& gradient) {
    // A pose is interpolated between two poses, so each gets its share of the gradient.
    const auto [left, s] = track_.find_segment(t_s);
    add_gradient(left, 1.0 - s, gradient);
    if (s != 0.0) add_gradient(left + 1, s, gradient);
}

void TrackCorrection::add_gradient(std::size_t pose_index, double weight, const Twist& gradient) {
    if (std::all_of(gradient.begin(), gradient.end(), [weight](double g) { return weight * g == 0.0; }))
        return;
    for (std::size_t i = 0; i < 6; ++i) gradient_[6 * pose_index + i] += weight * gradient[i];
    visited_[pose_index] = true;
}

void TrackCorrection::run_adam_step(const PoseStepRates& step_rates) {
    for (std::size_t k = 0; k < visited_.size(); ++k) {
        if (!visited_[k]) continue;
        const double n = double(++n_steps_[k]), bias1 = 1.0 - std::pow(kBeta1, n),
                     bias2 = 1.0 - std::pow(kBeta2, n);
        for (std::size_t i = 6 * k; i < 6 * k + 6; ++i) {
            const bool is_translation = i < 6 * k + 3;
            const double g =
                gradient_[i] +
                2.0 * (is_translation ? step_rates.prior_per_m2 : step_rates.prior_per_rad2) * values_[i];
            moment1_[i] += (1.0 - kBeta1) * (g - moment1_[i]);
            moment2_[i] += (1.0 - kBeta2) * (g * g - moment2_[i]);
            values_[i] -= (is_translation ? step_rates.rate_m : step_rates.rate_rad) * (moment1_[i] / bias1) /
                          (std::sqrt(moment2_[i] / bias2) + kEpsilon);
            gradient_[i] = 0.0;
        }
        visited_[k] = false;
    }
}

void TrackCorrection::remove_mean_motion() {
    const auto n = double(track_.pose.size());
    glm::dvec3 centre(0.0), v(0.0), w(0.0);
    for (std::size_t k = 0; k < track_.pose.size(); ++k) {
        centre += track_.pose[k].translation / n;
        v += three_components(stored_correction(k), 0) / n;
        w += three_components(stored_correction(k), 3) / n;
    }
    for (std::size_t k = 0; k < track_.pose.size(); ++k) {
        const glm::dvec3 carried = v + glm::cross(w, track_.pose[k].translation - centre);
        for (int i = 0; i < 3; ++i) {
            values_[6 * k + std::size_t(i)] -= carried[i];
            values_[6 * k + 3 + std::size_t(i)] -= w[i];
        }
    }
}

}  // namespace relidar
