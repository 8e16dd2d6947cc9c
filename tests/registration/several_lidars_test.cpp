// SPDX-License-Identifier: Apache-2.0
// Sweeps at the same time form a single scan of the vehicle. A LiDAR that sweeps at other
// times uses the interpolated poses.
#include <numeric>

#include <gtest/gtest.h>

#include <relidar/log/checks.hpp>
#include <relidar/read/clouds.hpp>
#include <relidar/registration/registration.hpp>

#include "street_poses.hpp"
#include "support/two_lidars.hpp"

namespace relidar {
namespace {

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
    check_sequence(street);
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
