// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include <relidar/read/dataset.hpp>
#include <relidar/registration/registration.hpp>

namespace relidar {
namespace {

constexpr double kDegree = 0.017453292519943295;

/// A drift of 10 cm along the track, 5 cm of jitter, and a yaw that drifts by 2 degrees.
BoxTrack add_label_errors(BoxTrack box, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> jitter(0.0, 0.05);
    PoseTrack& track = box.world_from_box;
    for (std::size_t k = 0; k < track.pose.size(); ++k) {
        const double phase = double(k) / double(track.pose.size());
        const Pose error{glm::angleAxis(2.0 * kDegree * std::sin(6.0 * phase), glm::dvec3(0.0, 0.0, 1.0)),
                         {0.1 * std::cos(4.0 * phase) + jitter(random), jitter(random), 0.0}};
        track.pose[k] = track.pose[k] * error;
    }
    return box;
}

/// The mean error is removed first: points do not determine a constant offset of a box.
struct TrackError {
    double along_m = 0.0, across_m = 0.0, yaw_rad = 0.0;
};
TrackError measure_error_of_track(const BoxTrack& box, const BoxTrack& exact) {
    std::vector<glm::dvec3> errors;  // x, y, yaw
    glm::dvec3 mean(0.0);
    for (std::size_t k = 0; k < box.world_from_box.pose.size(); ++k) {
        const Pose error = inverse(exact.world_from_box.pose[k]) * box.world_from_box.pose[k];
        errors.push_back(
            {error.translation.x, error.translation.y, 2.0 * std::atan2(error.rotation.z, error.rotation.w)});
        mean += errors.back() / double(box.world_from_box.pose.size());
    }
    TrackError result;
    for (const glm::dvec3& error : errors) {
        result.along_m = std::max(result.along_m, std::abs(error.x - mean.x));
        result.across_m = std::max(result.across_m, std::abs(error.y - mean.y));
        result.yaw_rad = std::max(result.yaw_rad, std::abs(error.z - mean.z));
    }
    return result;
}

/// Only the rear of the car is visible. It determines the position along the track and
/// the yaw. Only the labels determine the position across the track.
TEST(RegisterActors, CorrectsDriftingLabels) {
    const Log exact = make_street_log({.n_frames = 30, .rows = 64, .columns = 1024});
    Log street = exact;
    for (std::size_t i = 0; i < street.boxes.size(); ++i)
        street.boxes[i] = add_label_errors(street.boxes[i], i + 1);
    const Log labelled = street;
    const Split split = split_frames(street, 10);
    const ActorRegistrationResult registration = register_actors(street, split.train);
    EXPECT_GT(registration.n_registered, 0u);
    const TrackError before = measure_error_of_track(labelled.boxes[0], exact.boxes[0]),
                     after = measure_error_of_track(street.boxes[0], exact.boxes[0]);
    EXPECT_GT(before.along_m, 0.08);
    EXPECT_GT(before.yaw_rad, 1.9 * kDegree);
    EXPECT_LT(after.along_m, 0.01);
    EXPECT_LT(after.yaw_rad, 0.3 * kDegree);
    EXPECT_LT(after.across_m, before.across_m + 0.01);
}

TEST(RegisterActors, KeepsExactLabels) {
    const Log exact = make_street_log({.n_frames = 12, .rows = 32, .columns = 512});
    Log street = exact;
    register_actors(street, split_frames(street, 0).train);
    for (std::size_t i = 0; i < street.boxes.size(); ++i)
        EXPECT_LT(measure_error_of_track(street.boxes[i], exact.boxes[i]).along_m, 0.01) << "box " << i;
}

/// Adds Gaussian noise to all ranges. Returns the largest distance, in metres, by which
/// this noise moves a pose of a registered box.
double move_by_noise(const Log& log, double sigma_m) {
    Log registered = log, noisy = log;
    std::mt19937_64 random(5);
    std::normal_distribution<double> noise_m(0.0, sigma_m);
    for (Frame& frame : noisy.frames)
        for (float& range_m : frame.scan.range_m)
            if (range_m > 0.0f) range_m = float(range_m + noise_m(random));
    const std::vector<int> frames = split_frames(log, 10).train;
    EXPECT_EQ(register_actors(registered, frames).n_registered, log.boxes.size());
    register_actors(noisy, frames);
    double largest_m = 0.0;
    for (std::size_t i = 0; i < log.boxes.size(); ++i) {
        const std::vector<Pose>&poses = registered.boxes[i].world_from_box.pose,
              &noisy_poses = noisy.boxes[i].world_from_box.pose;
        for (std::size_t k = 0; k < poses.size(); ++k)
            largest_m = std::max(largest_m, glm::distance(poses[k].translation, noisy_poses[k].translation));
    }
    return largest_m;
}

TEST(RegisterActors, MovesBoxesLittleIfRangesChangeLittle) {
    for (const std::uint64_t seed : {1, 2}) {
        Log street = make_street_log({.seed = seed, .n_frames = 20, .rows = 32, .columns = 512});
        for (std::size_t i = 0; i < street.boxes.size(); ++i)
            street.boxes[i] = add_label_errors(street.boxes[i], 10 * seed + i);
        EXPECT_LT(move_by_noise(street, 1e-5), 1e-4) << "seed " << seed;
        EXPECT_LT(move_by_noise(street, 5e-3), 0.01) << "seed " << seed;
    }
}

TEST(RegisterActors, FindsStandingCarsWithDriftingLabels) {
    Log street = make_street_log({.n_frames = 20, .rows = 64, .columns = 1024, .speed_mps = 0.001});
    ASSERT_FALSE(street.boxes.empty());
    BoxTrack& box = street.boxes[0];
    std::vector<Pose>& poses = box.world_from_box.pose;
    for (std::size_t k = 0; k < poses.size(); ++k)
        poses[k] =
            poses[k] * Pose{{1.0, 0.0, 0.0, 0.0}, {2.5 * double(k) / double(poses.size()) - 1.25, 0.0, 0.0}};
    ASSERT_TRUE(box.is_moving());
    const ActorRegistrationResult registration = register_actors(street, split_frames(street, 0).train);
    EXPECT_EQ(registration.n_standing, 1u);
    EXPECT_FALSE(box.is_moving());
}

}  // namespace
}  // namespace relidar
