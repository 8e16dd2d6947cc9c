// SPDX-License-Identifier: Apache-2.0
#include "street_poses.hpp"

#include <algorithm>
#include <cmath>
#include <random>

namespace relidar::test {
namespace {

double median(std::vector<double> values) {
    std::nth_element(values.begin(), values.begin() + std::ptrdiff_t(values.size() / 2), values.end());
    return values[values.size() / 2];
}

}  // namespace

Log set_poses(Log street, PoseTrack track) {
    set_trajectory(street, std::move(track));
    return street;
}

PoseTrack perturb_track(PoseTrack track, double sigma_m, double sigma_rad, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal(0.0, 1.0 / std::sqrt(3.0));
    for (Pose& pose : track.pose) {
        Twist twist;
        for (std::size_t i = 0; i < 6; ++i) twist[i] = (i < 3 ? sigma_m : sigma_rad) * normal(random);
        pose = apply_twist(pose, twist);
    }
    return track;
}

PoseTrack add_drift(PoseTrack track, double amplitude_m, double amplitude_rad) {
    for (std::size_t k = 0; k < track.pose.size(); ++k) {
        const double x = 2.0 * kPi * double(k) / double(track.pose.size());
        const double m = amplitude_m, w = amplitude_rad;
        track.pose[k] =
            apply_twist(track.pose[k], {m * std::sin(x), m * std::cos(1.3 * x), 0.5 * m * std::sin(0.7 * x),
                                        0.4 * w * std::sin(x), 0.5 * w * std::cos(x), w * std::sin(1.1 * x)});
    }
    return track;
}

PoseTrack add_drift_and_jumps(const PoseTrack& exact) {
    PoseTrack track = exact;
    const std::size_t n = exact.pose.size();
    for (std::size_t k = 1; k < n; ++k) {
        Pose step = inverse(exact.pose[k - 1]) * exact.pose[k];
        const double driven_length_m = glm::length(step.translation),
                     drift_rad = 0.01 * driven_length_m * kPi / 180.0;
        step.translation *= 1.01;
        step.rotation = glm::normalize(step.rotation * glm::angleAxis(drift_rad, glm::dvec3(0, 0, 1)) *
                                       glm::angleAxis(0.3 * drift_rad, glm::dvec3(0, 1, 0)));
        track.pose[k] = track.pose[k - 1] * step;
        if (k % (n / 5) == 0)
            track.pose[k].translation +=
                0.3 * glm::normalize(glm::dvec3(std::sin(double(k)), std::cos(double(k)), 0.2));
    }
    return track;
}

namespace {

/// Removes the mean rigid motion at the given positions between a track and the exact
/// track.
PoseTrack align_track(PoseTrack track, const PoseTrack& exact, const std::vector<int>& positions) {
    glm::dvec3 centre(0.0), v(0.0), w(0.0);
    for (const int k : positions) {
        const Twist twist = compute_twist(exact.pose[std::size_t(k)], track.pose[std::size_t(k)]);
        centre += track.pose[std::size_t(k)].translation / double(positions.size());
        v += glm::dvec3(twist[0], twist[1], twist[2]) / double(positions.size());
        w += glm::dvec3(twist[3], twist[4], twist[5]) / double(positions.size());
    }
    const glm::dquat rotation_correction = apply_twist(Pose{}, {0, 0, 0, -w.x, -w.y, -w.z}).rotation;
    for (Pose& pose : track.pose)
        pose = {glm::normalize(rotation_correction * pose.rotation),
                centre - v + rotation_correction * (pose.translation - centre)};
    return track;
}

}  // namespace

PoseError error_of(PoseTrack track, const PoseTrack& exact, const std::vector<int>& positions) {
    const Pose start =
        exact.pose[std::size_t(positions.front())] * inverse(track.pose[std::size_t(positions.front())]);
    for (Pose& pose : track.pose) pose = start * pose;  // close enough to average rotations
    for (int i = 0; i < 5; ++i) track = align_track(std::move(track), exact, positions);
    std::vector<double> metres, degrees;
    double squares = 0.0;
    for (const int k : positions) {
        const Twist e = compute_twist(exact.pose[std::size_t(k)], track.pose[std::size_t(k)]);
        metres.push_back(glm::length(glm::dvec3(e[0], e[1], e[2])));
        degrees.push_back(glm::length(glm::dvec3(e[3], e[4], e[5])) * 180.0 / kPi);
        squares += metres.back() * metres.back();
    }
    return {median(metres), median(degrees), std::sqrt(squares / double(positions.size())),
            *std::max_element(metres.begin(), metres.end()),
            *std::max_element(degrees.begin(), degrees.end())};
}

}  // namespace relidar::test
