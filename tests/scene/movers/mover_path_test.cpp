// SPDX-License-Identifier: Apache-2.0
// Tests the smoothed paths and headings of moving objects against their exact motion.
#include <algorithm>

#include <gtest/gtest.h>

#include <relidar/base/math.hpp>

#include "base/random.hpp"
#include "scene/movers/mover_tracks.hpp"

namespace relidar {
namespace {

std::vector<double> make_tenths(int count) {
    std::vector<double> times;
    for (int k = 0; k < count; ++k) times.push_back(3.0 + 0.1 * k + (k > 20 ? 0.4 : 0.0));  // with a gap
    return times;
}

TEST(MoverPath, KeepsConstantAcceleration) {
    const std::vector<double> times = make_tenths(40);
    std::vector<glm::dvec3> positions_m;
    for (const double t : times) positions_m.push_back({20.0 - 3.0 * t + 0.8 * t * t, 5.0 * t, 0.1 * t});
    const std::vector<KinematicState> path = smooth_path(times, positions_m);
    for (std::size_t k = 0; k < times.size(); ++k) {
        EXPECT_LT(glm::distance(path[k].position_m, positions_m[k]), 0.01) << k;
        EXPECT_LT(glm::distance(path[k].velocity_mps, glm::dvec3(-3.0 + 1.6 * times[k], 5.0, 0.1)), 0.05);
        const double later = times[k] + 0.05;
        const glm::dvec3 truth(20.0 - 3.0 * later + 0.8 * later * later, 5.0 * later, 0.1 * later);
        EXPECT_LT(glm::distance(path[k].position_after(0.05), truth), 0.02);
    }
}

TEST(MoverPath, SpeedsNeedNoShortTimeSteps) {
    for (const double step_s : {0.1, 0.5, 2.0}) {
        BoxTrack box;
        for (int k = 0; k < 30; ++k) {
            box.world_from_box.time_s.push_back(step_s * k);
            box.world_from_box.pose.push_back({{}, {3.0 * step_s * k, 0.0, 0.0}});
        }
        const std::vector<double> speeds = speeds_mps(box);
        EXPECT_GE(speeds.size(), 25u) << step_s;
        for (const double speed : speeds) EXPECT_NEAR(speed, 3.0, 1e-9) << step_s;
    }
}

TEST(MoverPath, TakesNoiseOutAndLeavesOutliersAside) {
    const std::vector<double> times = make_tenths(60);
    std::vector<glm::dvec3> truth, positions_m;
    Random random(5);
    for (const double t : times) {
        // a curve of 8 m radius at 4 m/s
        truth.push_back({8.0 * std::sin(0.5 * t), 8.0 - 8.0 * std::cos(0.5 * t), 0.0});
        positions_m.push_back(truth.back() +
                              0.05 * glm::dvec3(random.sample_normal(), random.sample_normal(), 0.0));
    }
    positions_m[30] += glm::dvec3(2.0, -2.0, 0.0);
    const std::vector<KinematicState> path = smooth_path(times, positions_m);
    std::vector<glm::dvec3> smooth;
    double squares = 0.0;
    for (std::size_t k = 0; k < times.size(); ++k) {
        smooth.push_back(path[k].position_m);
        const double off = glm::distance(path[k].position_m, truth[k]);
        squares += off * off / double(times.size());
        EXPECT_LT(off, 0.15) << k;
    }
    EXPECT_LT(std::sqrt(squares), 0.05) << "of noise of 0.07 m";
    const std::vector<double> yaw = path_headings_rad(smooth);
    for (std::size_t k = 15; k + 15 < times.size(); ++k)
        EXPECT_LT(std::abs(std::remainder(yaw[k] - 0.5 * times[k], 2.0 * kPi)), 3.0 * kPi / 180.0) << k;
}

/// An object brakes, stops for three seconds with position noise of 3 cm, and drives on.
/// Its heading must stay constant during the stop.
TEST(MoverPath, StandsWithTheHeadingItCameWith) {
    std::vector<double> times;
    std::vector<glm::dvec3> positions_m, smooth;
    Random random(7);
    for (int k = 0; k < 100; ++k) {
        // at 2 m/s^2
        const double t = 0.1 * k, brakes = std::clamp(2.0 - (t - 1.0), 0.0, 2.0),
                     starts = std::max(t - 6.0, 0.0);
        times.push_back(t);
        positions_m.push_back(
            glm::dvec3(4.0 * std::min(t - 1.0, 0.0) - brakes * brakes + starts * starts, 0.0, 0.0) +
            0.03 * glm::dvec3(random.sample_normal(), random.sample_normal(), 0.0));
    }
    for (const KinematicState& state : smooth_path(times, positions_m)) smooth.push_back(state.position_m);
    const std::vector<double> yaw = path_headings_rad(smooth);
    for (std::size_t k = 0; k < yaw.size(); ++k) EXPECT_LT(std::abs(yaw[k]), 3.0 * kPi / 180.0) << k;
    for (std::size_t k = 31; k < 60; ++k)
        EXPECT_LT(std::abs(yaw[k] - yaw[k - 1]), 0.5 * kPi / 180.0) << "it stands, " << k;
}

}  // namespace
}  // namespace relidar
