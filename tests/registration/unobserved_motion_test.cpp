// SPDX-License-Identifier: Apache-2.0
// Scans on straight roads between smooth walls do not show how far the vehicle drove. The
// poses of the log must then stay. The true poses are known.
#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <relidar/registration/registration.hpp>

#include "registration/unobserved_motion.hpp"
#include "street_poses.hpp"

namespace relidar {
namespace {

using street::StreetShape;
using test::record_drive;
using Shapes = std::vector<StreetShape>;

constexpr double kYaw_rad = 0.6;  // direction of the road in the world
constexpr int kFrames = 12;

StreetShape make_box(double x_m, double y_m, double z_m, const glm::dvec3& size_m) {
    const double c = std::cos(kYaw_rad), s = std::sin(kYaw_rad);
    return {.centre = {c * x_m - s * y_m, s * x_m + c * y_m, z_m}, .half = 0.5 * size_m, .yaw_rad = kYaw_rad};
}

Shapes make_tunnel() {
    return {make_box(0, 3, 2, {400, 0.5, 4}), make_box(0, -3, 2, {400, 0.5, 4}),
            make_box(0, 0, 4.2, {400, 8, 0.4})};
}

/// Two barriers, a guard rail, and a thin post every 17 m.
Shapes make_motorway() {
    Shapes shapes{make_box(0, 12, 1.5, {600, 0.3, 3}), make_box(0, -12, 1.5, {600, 0.3, 3}),
                  make_box(0, -5, 0.6, {600, 0.1, 0.4})};
    for (int x = -200; x < 200; x += 17) shapes.push_back(make_box(x, 6, 0.5, {0.1, 0.1, 1}));
    return shapes;
}

Shapes make_village() {
    Shapes shapes;
    for (int i = -8; i < 12; ++i)
        for (const double side : {-1.0, 1.0})
            shapes.push_back(make_box(11 * i + 3 * side, side * (11 + i % 3), 3, {7, 6, 6}));
    return shapes;
}

PoseTrack drive_along_road(double speed_mps) {
    PoseTrack track;
    const glm::dquat rotation = glm::angleAxis(kYaw_rad, glm::dvec3(0, 0, 1));
    for (int k = 0; k < kFrames; ++k)
        track.append(0.1 * k, {rotation, rotation * glm::dvec3(0.1 * k * speed_mps, 0, 1.8)});
    return track;
}

/// Returns the largest change of a position along the road.
double change_along_road_m(const PoseTrack& first, const PoseTrack& second) {
    const glm::dvec3 road(std::cos(kYaw_rad), std::sin(kYaw_rad), 0);
    double largest_m = 0.0;
    for (std::size_t k = 0; k < first.pose.size(); ++k)
        largest_m = std::max(
            largest_m, std::abs(glm::dot(road, first.pose[k].translation - second.pose[k].translation)));
    return largest_m;
}

/// Returns the length of the part that each scan shows of a motion along the road by 1 m.
std::vector<double> measure_shown_m(const Log& log) {
    const Twist road{std::cos(kYaw_rad), std::sin(kYaw_rad), 0, 0, 0, 0};
    std::vector<double> shown_m;
    for (const auto& motions : find_unobserved_motions(log, split_frames(log, 0).train, {})) {
        const Twist shown = remove_unobserved(road, motions);
        shown_m.push_back(glm::length(glm::dvec3(shown[0], shown[1], shown[2])));
    }
    return shown_m;
}

TEST(UnobservedMotion, TruePosesStayInATunnelAndOnAMotorway) {
    for (const Shapes& shapes : {make_tunnel(), make_motorway()})
        for (const double speed_mps : {1.5, 25.0}) {
            const Log log = record_drive(drive_along_road(speed_mps), shapes, 512);
            const PoseTrack track = register_scans(log, split_frames(log, 5), {}).world_from_vehicle;
            EXPECT_LT(change_along_road_m(track, log.world_from_vehicle), 0.005) << speed_mps << " m/s";
            EXPECT_LT(test::error_of(track, log.world_from_vehicle, split_frames(log, 5).train).worst_m,
                      0.01);
            EXPECT_THAT(measure_shown_m(log), testing::Each(testing::Lt(0.5)));
        }
}

/// An offset across the tunnel is corrected, an equal offset along the tunnel stays.
TEST(UnobservedMotion, OnlyObservedErrorsAreCorrected) {
    const Log exact = record_drive(drive_along_road(8.0), make_tunnel(), 512);
    const glm::dvec3 along(std::cos(kYaw_rad), std::sin(kYaw_rad), 0), across(-along.y, along.x, 0);
    PoseTrack wrong = exact.world_from_vehicle;
    for (std::size_t k = 0; k < wrong.pose.size(); ++k)
        wrong.pose[k].translation += 0.08 * std::sin(double(k)) * (along + across);
    const PoseTrack track =
        register_scans(test::set_poses(exact, wrong), split_frames(exact, 0), {}).world_from_vehicle;
    EXPECT_LT(change_along_road_m(track, wrong), 0.005);
    double mean_m = 0.0, largest_m = 0.0;
    for (const Pose& pose : track.pose) mean_m += glm::dot(across, pose.translation) / double(kFrames);
    for (const Pose& pose : track.pose)
        largest_m = std::max(largest_m, std::abs(glm::dot(across, pose.translation) - mean_m));
    EXPECT_LT(largest_m, 0.005);
}

TEST(UnobservedMotion, AVillageShowsAllMotions) {
    const Log log = record_drive(drive_along_road(8.0), make_village(), 512);
    EXPECT_THAT(measure_shown_m(log), testing::Each(testing::DoubleNear(1.0, 0.01)));
}

/// If only errors of the normals contribute, the matrices of points and noise are equal.
TEST(UnobservedMotion, IsWhatNoiseAloneWouldShow) {
    Matrix6 noise = Matrix6::Identity(), information = noise;
    noise.bottomRightCorner<3, 3>() *= 100.0;
    information = 500.0 * noise;
    // The vehicle turns about a point 4 m ahead: a sideways motion and a rotation.
    Vector6 motion;
    motion << 0.0, 4.0, 0.0, 0.0, 0.0, 1.0;
    const Vector6 dual = noise * motion / motion.dot(noise * motion);
    information -= 499.0 * motion.dot(noise * motion) * dual * dual.transpose();
    const std::vector<UnobservedMotion> unobserved =
        find_unobserved(information, noise, min_information(true));
    ASSERT_EQ(unobserved.size(), 1u);
    EXPECT_LT(to_vector(remove_unobserved(to_twist(motion), unobserved)).norm(), 1e-3 * motion.norm());
    Vector6 other;
    // orthogonal to the motion, if a radian counts as 5 m: 4 * 25 - 5^2 * 4 = 0
    other << 1.0, 25.0, 0.0, 0.0, 0.0, -4.0;
    EXPECT_LT((to_vector(remove_unobserved(to_twist(other), unobserved)) - other).norm(), 1e-4);
}

}  // namespace
}  // namespace relidar
