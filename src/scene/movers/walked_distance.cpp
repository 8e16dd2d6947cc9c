// SPDX-License-Identifier: Apache-2.0
// Computes the distance that an actor has walked, without the jitter of its labels.
#include "scene/movers/walked_distance.hpp"

namespace relidar {
namespace {

// Time over which positions are averaged, because labelled boxes jitter.
constexpr double kAveraging_s = 1.0;
constexpr double kMaxStandingSpeed_mps = 0.2;

}  // namespace

WalkedDistanceTrack::WalkedDistanceTrack(const PoseTrack& track) : time_s_(track.time_s) {
    const auto average = [&](double t_s) {
        // The window shrinks near the ends of the track, so that it stays symmetric.
        const double half = std::min({0.5 * kAveraging_s, t_s - time_s_.front(), time_s_.back() - t_s});
        constexpr int kStepsPerSide = 5;  // number of steps in each direction
        glm::dvec3 sum(0.0);
        for (int k = -kStepsPerSide; k <= kStepsPerSide; ++k)
            sum += track.pose_at(t_s + half * k / kStepsPerSide).translation;
        return sum / double(2 * kStepsPerSide + 1);
    };
    glm::dvec3 before(0.0);
    double sum = 0.0;
    for (std::size_t i = 0; i < time_s_.size(); ++i) {
        const glm::dvec3 at = average(time_s_[i]);
        const double step = i == 0 ? 0.0 : glm::distance(before, at);
        // Slower steps are jitter of the labels or standing, so they add no distance.
        if (i > 0 && step > kMaxStandingSpeed_mps * (time_s_[i] - time_s_[i - 1])) sum += step;
        walked_m_.push_back(sum);
        before = at;
    }
}

double WalkedDistanceTrack::walked_m(double t_s) const {
    if (time_s_.size() < 2) return 0.0;
    const auto after = std::upper_bound(time_s_.begin() + 1, time_s_.end() - 1, t_s);
    const std::size_t i = std::size_t(after - time_s_.begin());
    const double s = (t_s - time_s_[i - 1]) / (time_s_[i] - time_s_[i - 1]);
    return walked_m_[i - 1] + s * (walked_m_[i] - walked_m_[i - 1]);
}

}  // namespace relidar
