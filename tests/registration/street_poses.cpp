// SPDX-License-Identifier: Apache-2.0
#include "street_poses.hpp"

#include <algorithm>
#include <cmath>
#include <random>

namespace relidar::test {
namespace {

double median(std::vector<double> x) {
    std::nth_element(x.begin(), x.begin() + std::ptrdiff_t(x.size() / 2), x.end());
    return x[x.size() / 2];
}

}  // namespace

PoseTrack perturbed(PoseTrack track, double sigma_m, double sigma_rad, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal(0.0, 1.0 / std::sqrt(3.0));
    for (Pose& pose : track.pose) {
        Twist twist;
        for (std::size_t i = 0; i < 6; ++i) twist[i] = (i < 3 ? sigma_m : sigma_rad) * normal(random);
        pose = moved(pose, twist);
    }
    return track;
}

PoseTrack drifting(PoseTrack track, double amplitude_m, double amplitude_rad) {
    for (std::size_t k = 0; k < track.pose.size(); ++k) {
        const double x = 2.0 * kPi * double(k) / double(track.pose.size());
        const double m = amplitude_m, w = amplitude_rad;
        track.pose[k] = moved(track.pose[k], {m * std::sin(x), m * std::cos(1.3 * x), 0.5 * m * std::sin(0.7 * x), 0.4 * w * std::sin(x), 0.5 * w * std::cos(x), w * std::sin(1.1 * x)});
    }
    return track;
}

PoseError error_of(const PoseTrack& track, const PoseTrack& exact, const std::vector<int>& positions) {
    std::vector<Twist> e;
    glm::dvec3 centre(0.0), v(0.0), w(0.0);
    const auto n = double(positions.size());
    for (const int k : positions) {
        e.push_back(twist_between(exact.pose[std::size_t(k)], track.pose[std::size_t(k)]));
        centre += exact.pose[std::size_t(k)].translation / n;
        v += glm::dvec3(e.back()[0], e.back()[1], e.back()[2]) / n;
        w += glm::dvec3(e.back()[3], e.back()[4], e.back()[5]) / n;
    }
    std::vector<double> metres, degrees;
    for (std::size_t i = 0; i < e.size(); ++i) {
        const glm::dvec3 carried = v + glm::cross(w, exact.pose[std::size_t(positions[i])].translation - centre);
        metres.push_back(glm::length(glm::dvec3(e[i][0], e[i][1], e[i][2]) - carried));
        degrees.push_back(glm::length(glm::dvec3(e[i][3], e[i][4], e[i][5]) - w) * 180.0 / kPi);
    }
    return {median(metres), median(degrees)};
}

}  // namespace relidar::test
