// SPDX-License-Identifier: Apache-2.0
// Registers moving boxes on the synthetic street, whose exact tracks are known. The
// labels have a slow drift along the track, jitter, and errors of the yaw.
#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include <relidar/log/dataset.hpp>
#include <relidar/log/registration.hpp>

namespace relidar {
namespace {

constexpr double kDegree = 0.017453292519943295;

/// Adds typical errors of labels to all poses of a box: a drift of 10 cm along the track,
/// jitter with a standard deviation of 2 cm, and a yaw that drifts by 2 degrees.
BoxTrack with_label_errors(BoxTrack box, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> jitter(0.0, 0.02);
    PoseTrack& track = box.world_from_box;
    for (std::size_t k = 0; k < track.pose.size(); ++k) {
        const double phase = double(k) / double(track.pose.size());
        const Pose error{glm::angleAxis(2.0 * kDegree * std::sin(6.0 * phase), glm::dvec3(0.0, 0.0, 1.0)),
                         {0.1 * std::cos(4.0 * phase) + jitter(random), jitter(random), 0.0}};
        track.pose[k] = track.pose[k] * error;
    }
    return box;
}

/// Errors of a track: the largest difference to the exact track, after the mean error in
/// the frame of the box is removed. Points do not determine a constant offset of a box.
struct TrackError {
    double largest_m = 0.0, largest_rad = 0.0;
};
TrackError error_of_track(const BoxTrack& box, const BoxTrack& exact) {
    std::vector<glm::dvec3> offset_m;
    std::vector<double> yaw_rad;
    glm::dvec3 mean_m(0.0);
    double mean_rad = 0.0;
    const auto n = double(box.world_from_box.pose.size());
    for (std::size_t k = 0; k < box.world_from_box.pose.size(); ++k) {
        const Pose error = inverse(exact.world_from_box.pose[k]) * box.world_from_box.pose[k];
        offset_m.push_back(error.translation);
        yaw_rad.push_back(2.0 * std::atan2(error.rotation.z, error.rotation.w));
        mean_m += offset_m.back() / n;
        mean_rad += yaw_rad.back() / n;
    }
    TrackError result;
    for (std::size_t k = 0; k < offset_m.size(); ++k) {
        result.largest_m = std::max(result.largest_m, glm::length(glm::dvec2(offset_m[k] - mean_m)));
        result.largest_rad = std::max(result.largest_rad, std::abs(yaw_rad[k] - mean_rad));
    }
    return result;
}

TEST(RegisterActors, CorrectsDriftingLabels) {
    SyntheticOptions options;
    options.n_frames = 30, options.rows = 64, options.columns = 1024;
    const Sequence exact = make_synthetic_street(options);
    Sequence street = exact;
    for (std::size_t i = 0; i < street.boxes.size(); ++i)
        street.boxes[i] = with_label_errors(street.boxes[i], i + 1);
    const Sequence labelled = street;
    const Split split = split_frames(street, 10);
    const ActorRegistration registration = register_actors(street, split.train);
    EXPECT_GT(registration.n_registered, 0u);
    std::size_t n_corrected = 0;
    for (std::size_t i = 0; i < street.boxes.size(); ++i) {
        if (error_of_track(street.boxes[i], labelled.boxes[i]).largest_m == 0.0) continue;
        ++n_corrected;
        const TrackError before = error_of_track(labelled.boxes[i], exact.boxes[i]),
                         after = error_of_track(street.boxes[i], exact.boxes[i]);
        EXPECT_LT(after.largest_m, 0.5 * before.largest_m) << "box " << i;
        EXPECT_LT(after.largest_m, 0.03) << "box " << i;
        EXPECT_LT(after.largest_rad, 0.6 * kDegree) << "box " << i;
        std::printf("box %zu: %.3f m, %.2f degrees -> %.3f m, %.2f degrees\n", i, before.largest_m,
                    before.largest_rad / kDegree, after.largest_m, after.largest_rad / kDegree);
    }
    EXPECT_EQ(n_corrected, registration.n_registered);
}

/// Exact labels must not change, because a correction would only add noise.
TEST(RegisterActors, KeepsExactLabels) {
    SyntheticOptions options;
    options.n_frames = 12, options.rows = 32, options.columns = 512;
    const Sequence exact = make_synthetic_street(options);
    Sequence street = exact;
    register_actors(street, split_frames(street, 0).train);
    for (std::size_t i = 0; i < street.boxes.size(); ++i)
        EXPECT_LT(error_of_track(street.boxes[i], exact.boxes[i]).largest_m, 0.01) << "box " << i;
}

/// A parked car whose label drifts by 2.5 m must be recognised as standing: all its poses
/// become equal.
TEST(RegisterActors, FindsParkedCarsWithDriftingLabels) {
    SyntheticOptions options;
    options.n_frames = 20, options.rows = 64, options.columns = 1024, options.moving_cars = false;
    Sequence street = make_synthetic_street(options);
    ASSERT_FALSE(street.boxes.empty());
    std::size_t n_drifting = 0;
    for (BoxTrack& box : street.boxes) {
        std::vector<Pose>& poses = box.world_from_box.pose;
        for (std::size_t k = 0; k < poses.size(); ++k)
            poses[k] = poses[k] * Pose{{}, {2.5 * double(k) / double(poses.size()) - 1.25, 0.0, 0.0}};
        n_drifting += box.moves();
    }
    ASSERT_GT(n_drifting, 0u);
    const ActorRegistration registration = register_actors(street, split_frames(street, 0).train);
    EXPECT_GT(registration.n_standing, 0u);
    for (const BoxTrack& box : street.boxes) n_drifting -= !box.moves();
    EXPECT_EQ(n_drifting, 0u);
}

}  // namespace
}  // namespace relidar
