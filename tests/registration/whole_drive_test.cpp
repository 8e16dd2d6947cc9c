// SPDX-License-Identifier: Apache-2.0
// From exact poses, from poses with drift and jumps, and without poses. Odometry divides
// the 400 sweeps into two sections.
#include <gtest/gtest.h>

#include <relidar/registration/registration.hpp>

#include "street_poses.hpp"

namespace relidar {
namespace {

constexpr int kSweeps = 400;

class WholeDrive : public testing::Test {
protected:
    static const Log& drive() {
        static const Log drive = test::drive_around_block(kSweeps);
        return drive;
    }

    static RegistrationResult register_street(const PoseTrack& initial_poses, bool use_pose_motion) {
        Log wrong = drive();
        set_trajectory(wrong, initial_poses);
        RegistrationOptions options;
        options.use_pose_motion = use_pose_motion;
        return register_scans(wrong, split_frames(drive(), 10), options);
    }

    static void expect_registered(const RegistrationResult& result) {
        const test::PoseError error = test::error_of(result.world_from_vehicle, drive().world_from_vehicle,
                                                     split_frames(drive(), 0).train);
        EXPECT_LT(error.rms_m, 0.02);
        EXPECT_LT(error.worst_m, 0.05);
        EXPECT_LT(error.median_deg, 0.02);
        EXPECT_LT(error.worst_deg, 0.05);
        EXPECT_TRUE(result.lost.empty());
        EXPECT_GT(result.on_planes, 0.3);
    }
};

TEST_F(WholeDrive, FindsPosesBackFromDriftAndJumps) {
    const PoseTrack initial_poses = test::add_drift_and_jumps(drive().world_from_vehicle);
    const int last = kSweeps - 1;
    EXPECT_GT(
        test::error_of(initial_poses, drive().world_from_vehicle, {0, last / 3, 2 * last / 3, last}).worst_m,
        1.0);
    expect_registered(register_street(initial_poses, true));
}

TEST_F(WholeDrive, StaysWithExactPoses) {
    expect_registered(register_street(drive().world_from_vehicle, true));
}

TEST_F(WholeDrive, NeedsNoPoses) {
    PoseTrack none = drive().world_from_vehicle;
    for (Pose& pose : none.pose) pose = {};
    const RegistrationResult registration = register_street(none, false);
    expect_registered(registration);
    const std::vector<int> train = split_frames(drive(), 10).train;
    EXPECT_EQ(registration.world_from_vehicle.pose[std::size_t(train[train.size() / 2])].translation,
              glm::dvec3(0.0));
}

}  // namespace
}  // namespace relidar
