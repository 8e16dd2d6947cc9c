// SPDX-License-Identifier: Apache-2.0
// Compares poses of the synthetic street with the exact poses. Sweeps of several LiDARs
// at the same time form a single scan. A LiDAR that sweeps at other times uses the
// interpolated poses.
#include <numeric>
#include <random>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>
#include <relidar/log/checks.hpp>
#include <relidar/read/clouds.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/registration/registration.hpp>
#include "street_poses.hpp"
#include "support/names.hpp"
#include "support/two_lidars.hpp"

namespace relidar {
namespace {

using test::error_of;
using test::PoseError;

Log make_street_of(int n_frames) {
    return make_street_log({.n_frames = n_frames, .rows = 32, .columns = 256});
}

RegistrationOptions ignore_movers(const Log& street) {
    RegistrationOptions options;
    options.movers = street.boxes;
    return options;
}

RegistrationResult register_street(const Log& street, int test_every = 0) {
    return register_scans(street, split_frames(street, test_every), ignore_movers(street));
}

void expect_registered(const RegistrationResult& result, const PoseTrack& exact, const Split& split) {
    const PoseTrack& track = result.world_from_vehicle;
    const PoseError train = error_of(track, exact, split.train);
    EXPECT_LT(train.median_m, 0.005);
    EXPECT_LT(train.median_deg, 0.02);
    if (split.test.empty()) return;
    std::vector<int> all = split.train;
    all.insert(all.end(), split.test.begin(), split.test.end());
    EXPECT_LT(error_of(track, exact, all).median_m, 0.005);
    for (const int position : split.test) {  // relative to the previous training pose
        const auto k = std::size_t(position);
        const Pose exact_step = inverse(exact.pose[k - 1]) * exact.pose[k],
                   step = inverse(track.pose[k - 1]) * track.pose[k];
        EXPECT_LT(glm::length(step.translation - exact_step.translation), 0.02) << "held-out frame " << k;
    }
}

/// Each sweep covers a fifth of the street, so only all sweeps together connect its ends.
TEST(RegisterScans, LongStreetStaysWhereItIs) {
    const Log street = make_street_log({.seed = 7, .n_frames = 400, .rows = 32, .columns = 256});
    const RegistrationResult registration = register_street(street, 10);
    EXPECT_TRUE(registration.lost.empty()) << registration.lost.size() << " scans are lost";
    const PoseError error =
        error_of(registration.world_from_vehicle, street.world_from_vehicle, split_frames(street, 10).train);
    EXPECT_LT(error.rms_m, 0.03);
    EXPECT_LT(error.worst_m, 0.06);
}

TEST(RegisterScans, FindsPosesBackAfterNoiseAndDrift) {
    const Log street = make_street_of(21);
    const PoseTrack& exact = street.world_from_vehicle;
    const Split split = split_frames(street, 10);
    for (const PoseTrack& wrong : {test::perturb_track(exact, 0.05, 0.3 * test::kDegree, 1),
                                   test::add_drift(exact, 0.2, 0.3 * test::kDegree)})
        expect_registered(register_street(test::set_poses(street, wrong), 10), exact, split);
}

/// With only two scans, a plane needs more points of each scan.
TEST(RegisterScans, TwoScansAreEnough) {
    const Log street = make_street_of(3);
    const PoseTrack& exact = street.world_from_vehicle;
    PoseTrack wrong = test::perturb_track(exact, 0.1, 0.3 * test::kDegree, 6);
    const RegistrationResult registration =
        register_scans(test::set_poses(street, wrong), {{0, 2}, {1}}, ignore_movers(street));
    ASSERT_TRUE(registration.done);
    EXPECT_TRUE(registration.lost.empty());
    const PoseError error = error_of(registration.world_from_vehicle, exact, {0, 1, 2});
    EXPECT_LT(error.worst_m, 0.01);
    EXPECT_LT(error.worst_deg, 0.05);
}

TEST(RegisterScans, WithoutARollingShutterToo) {
    const StreetOptions options{.n_frames = 11, .rows = 32, .columns = 256, .speed_mps = 1.0};
    Log street = make_street_log(options);
    for (Frame& frame : street.frames) {  // simulates a sensor that fires all rays at the same time
        RayTable rays = frame.scan.rays;
        std::fill(rays.time_offset_s.begin(), rays.time_offset_s.end(), 0.0f);
        frame.scan = cast_street_rays(options, rays, street.world_from_vehicle, frame.time_s);
    }
    street.rolling_shutter = false;
    const PoseTrack exact = street.world_from_vehicle;
    const PoseTrack wrong = test::perturb_track(exact, 0.05, 0.3 * test::kDegree, 2);
    expect_registered(register_street(test::set_poses(street, wrong), 5), exact, split_frames(street, 5));
}

TEST(RegisterScans, MeanCorrectionIsZeroAndExactPosesStay) {
    const Log street = make_street_of(11);
    const Log wrong =
        test::set_poses(street, test::perturb_track(street.world_from_vehicle, 0.05, 0.3 * test::kDegree, 3));
    const RegistrationResult registration = register_street(wrong);
    glm::dvec3 v(0.0), w(0.0);
    for (std::size_t k = 0; k < registration.world_from_vehicle.pose.size(); ++k) {
        const Twist c =
            compute_twist(wrong.world_from_vehicle.pose[k], registration.world_from_vehicle.pose[k]);
        v += glm::dvec3(c[0], c[1], c[2]);
        w += glm::dvec3(c[3], c[4], c[5]);
    }
    EXPECT_LT(glm::length(v), 1e-6);
    EXPECT_LT(glm::length(w), 1e-6);
    const RegistrationResult again = register_street(street);
    const PoseTrack &track = again.world_from_vehicle, &exact = street.world_from_vehicle;
    for (std::size_t k = 0; k < track.pose.size(); ++k)
        EXPECT_LT(glm::distance(track.pose[k].translation, exact.pose[k].translation), 0.01) << k;
    EXPECT_TRUE(again.lost.empty());
}

TEST(RegisterScans, HeldOutScansMoveNoOtherPose) {
    Log street = make_street_of(11);
    set_trajectory(street, test::perturb_track(street.world_from_vehicle, 0.05, 0.3 * test::kDegree, 4));
    const Split split = split_frames(street, 5);
    const RegistrationOptions options = ignore_movers(street);
    const PoseTrack track = register_scans(street, split, options).world_from_vehicle;
    Log other = street;
    for (const int k : split.test)
        for (float& range : other.frames[std::size_t(k)].scan.range_m) range *= 1.01f;
    const PoseTrack again = register_scans(other, split, options).world_from_vehicle;
    for (const int k : split.train) {
        EXPECT_EQ(track.pose[std::size_t(k)].translation, again.pose[std::size_t(k)].translation);
        EXPECT_EQ(track.pose[std::size_t(k)].rotation, again.pose[std::size_t(k)].rotation);
    }
    for (const int k : split.test)
        EXPECT_NE(track.pose[std::size_t(k)].translation, again.pose[std::size_t(k)].translation);
}

TEST(RegisterScans, AScanOfGarbageIsPlacedAsItsNeighbours) {
    Log street = make_street_of(11);
    const PoseTrack exact = street.world_from_vehicle;
    set_trajectory(street, test::add_drift(exact, 0.2, 0.3 * test::kDegree));
    std::mt19937_64 random(5);
    std::uniform_real_distribution<float> range(2.0f, 70.0f);
    for (float& r : street.frames[5].scan.range_m) r = range(random);
    const RegistrationResult registration = register_street(street);
    EXPECT_EQ(registration.lost, std::vector<std::size_t>{5});
    const PoseError error = error_of(registration.world_from_vehicle, exact, {0, 1, 2, 3, 4, 6, 7, 8, 9, 10});
    EXPECT_LT(error.median_m, 0.01);
    EXPECT_LT(error.median_deg, 0.03);
    EXPECT_LT(error_of(registration.world_from_vehicle, exact, {4, 5, 6}).median_m, 0.05);
}

TEST(RegisterScans, CorrectionsBeyondWhatIsAllowedAreNotBelieved) {
    Log street = make_street_of(11);
    PoseTrack track = street.world_from_vehicle;
    track.pose[4].translation += glm::dvec3(0.3, 0.4, 0.0);
    set_trajectory(street, track);
    RegistrationOptions options = ignore_movers(street);
    const RegistrationResult registration = register_scans(street, split_frames(street, 0), options);
    EXPECT_TRUE(registration.lost.empty()) << "half a metre is found";
    options.largest_m = 0.25;
    EXPECT_EQ(register_scans(street, split_frames(street, 0), options).lost, std::vector<std::size_t>{4});
}

TEST(RegisterScans, SaysWhatIsMissing) {
    Log street = make_street_of(4);
    const RegistrationResult one = register_scans(street, {{0}, {}}, {});
    EXPECT_TRUE(one.rounds.empty()) << "one scan is where it is";
    int n_polls = 0;
    RegistrationOptions options;
    options.stop = [&] { return ++n_polls == 3; };
    set_trajectory(street, test::perturb_track(street.world_from_vehicle, 0.05, 0.0, 1));
    const RegistrationResult stopped = register_scans(street, split_frames(street, 0), options);
    EXPECT_TRUE(stopped.stopped);
    EXPECT_EQ(stopped.world_from_vehicle.pose[2].translation, street.world_from_vehicle.pose[2].translation);
    for (Frame& frame : street.frames) std::fill(frame.scan.range_m.begin(), frame.scan.range_m.end(), 0.0f);
    EXPECT_THAT([&] { register_scans(street, split_frames(street, 0), {}); },
                testing::ThrowsMessage<DataError>(test::Names("4 training scans")));
}

StreetOptions make_two_lidar_options() {
    return {.n_frames = 12, .rows = 32, .columns = 256, .moving_cars = false};
}

Log make_staggered_street(double off_s) {
    const Log together = test::make_two_lidar_street(make_two_lidar_options());
    Log street = together;
    const RayTable rays = make_rays(street.lidars[1].sensor);
    street.frames.clear();
    street.world_from_vehicle = {};
    for (const Frame& frame : together.frames) {
        const double time_s = frame.time_s + frame.lidar * off_s;
        add_frame(street, frame.index, time_s, together.world_from_vehicle.pose_at(time_s), frame.lidar)
            .scan = frame.lidar == 0
                        ? frame.scan
                        : cast_street_rays(make_two_lidar_options(), rays, together.lidar_track(1), time_s);
    }
    check_log(street);
    return street;
}

/// Returns the error over all poses, if all scans were registered.
test::PoseError error_of(const RegistrationResult& result, const Log& street) {
    EXPECT_TRUE(result.done && result.lost.empty());
    std::vector<int> all(street.world_from_vehicle.pose.size());
    std::iota(all.begin(), all.end(), 0);
    return test::error_of(result.world_from_vehicle, street.world_from_vehicle, all);
}

TEST(SeveralLidars, AreRegisteredAsOneScanOfTheVehicle) {
    const Log street = test::make_two_lidar_street(make_two_lidar_options());
    const PoseTrack& exact = street.world_from_vehicle;
    const Split split = split_frames(street, 5);
    for (const PoseTrack& wrong : {test::perturb_track(exact, 0.05, 0.3 * test::kDegree, 1),
                                   test::add_drift(exact, 0.2, 0.3 * test::kDegree)}) {
        const test::PoseError error =
            error_of(register_scans(test::set_poses(street, wrong), split, {}), street);
        EXPECT_LT(error.median_m, 0.005);
        EXPECT_LT(error.worst_m, 0.02);
        EXPECT_LT(error.median_deg, 0.02);
    }
}

TEST(SeveralLidars, OneFindsWhatTheOtherMissed) {
    Log street = test::make_two_lidar_street(make_two_lidar_options());
    Scan& missed = street.frames[8].scan;
    std::fill(missed.range_m.begin(), missed.range_m.end(), 0.0f);
    PoseTrack wrong = street.world_from_vehicle;
    wrong.pose[4].translation += glm::dvec3(0.2, -0.3, 0.1);
    const RegistrationResult result =
        register_scans(test::set_poses(street, wrong), split_frames(street, 0), {});
    EXPECT_LT(error_of(result, street).worst_m, 0.02);
}

/// The times of the rays of the second LiDAR lie between poses of both LiDARs.
TEST(SeveralLidars, OneThatSweepsAtOtherTimesRidesAlong) {
    for (const double off_s : {0.05, 0.01, 0.09}) {
        const Log street = make_staggered_street(off_s);
        const PoseTrack& exact = street.world_from_vehicle;
        ASSERT_EQ(exact.pose.size(), 24u);
        const PoseTrack sweeps = test::make_two_lidar_street(make_two_lidar_options()).world_from_vehicle;
        const PoseTrack drift = test::add_drift(sweeps, 0.2, 0.3 * test::kDegree);
        PoseTrack wrong = exact;
        for (std::size_t k = 0; k < wrong.pose.size(); ++k)
            wrong.pose[k] =
                drift.pose_at(wrong.time_s[k]) * (inverse(sweeps.pose_at(wrong.time_s[k])) * wrong.pose[k]);
        const test::PoseError error =
            error_of(register_scans(test::set_poses(street, wrong), split_frames(street, 5), {}), street);
        EXPECT_LT(error.median_m, 0.01) << off_s;
        EXPECT_LT(error.worst_m, 0.03) << off_s;
    }
}

TEST(SeveralLidars, AreFollowedWithoutPoses) {
    const Log street = test::make_two_lidar_street(make_two_lidar_options());
    PoseTrack none = street.world_from_vehicle;
    for (Pose& pose : none.pose) pose = {};
    RegistrationOptions blind;
    blind.use_pose_motion = false;
    const test::PoseError error =
        error_of(register_scans(test::set_poses(street, none), split_frames(street, 5), blind), street);
    EXPECT_LT(error.median_m, 0.01);
    EXPECT_LT(error.worst_m, 0.03);
}

}  // namespace
}  // namespace relidar
