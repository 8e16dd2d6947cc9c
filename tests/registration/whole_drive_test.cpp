// SPDX-License-Identifier: Apache-2.0
// Registers a drive around a block: 400 sweeps, which odometry divides into two sections.
// Also detects roads that are driven again.
#include <gtest/gtest.h>

#include <relidar/read/dataset.hpp>
#include <relidar/registration/registration.hpp>
#include "registration/loops.hpp"
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

TEST_F(WholeDrive, NeedsNoPoses) {
    PoseTrack none = drive().world_from_vehicle;
    for (Pose& pose : none.pose) pose = {};
    const RegistrationResult registration = register_street(none, false);
    expect_registered(registration);
    const std::vector<int> train = split_frames(drive(), 10).train;
    EXPECT_EQ(registration.world_from_vehicle.pose[std::size_t(train[train.size() / 2])].translation,
              glm::dvec3(0.0));
}

LoopClosureResult close(const PoseTrack& track, const SubsampledScans& scans) {
    return close_loops(track, scans, {2.0, 0.5}, {0.5, 0.1}, [](double) { return true; });
}

SubsampledScans thin(const Log& log) {
    RegistrationOptions movers;
    movers.movers = log.boxes;
    return thin_sweeps(log, group_sweeps(log), std::vector<bool>(log.frames.size(), true), movers, 0.5);
}

PoseTrack bend_track(const PoseTrack& exact, double yaw_rad_per_m, double pitch_rad_per_m) {
    PoseTrack track = exact;
    for (std::size_t k = 1; k < track.pose.size(); ++k) {
        Pose step = inverse(exact.pose[k - 1]) * exact.pose[k];
        const double length = glm::length(step.translation);
        step.rotation = step.rotation * glm::angleAxis(yaw_rad_per_m * length, glm::dvec3(0, 0, 1)) *
                        glm::angleAxis(pitch_rad_per_m * length, glm::dvec3(0, 1, 0));
        track.pose[k] = track.pose[k - 1] * step;
    }
    return track;
}

double gap_m(const PoseTrack& track, const PoseTrack& exact) {
    return glm::distance((inverse(track.pose.front()) * track.pose.back()).translation,
                         (inverse(exact.pose.front()) * exact.pose.back()).translation);
}

TEST(CloseLoops, ADriveAroundABlockMeetsItsBeginning) {
    const Log drive = test::drive_around_block(300);
    const PoseTrack& exact = drive.world_from_vehicle;
    const PoseTrack drifted = bend_track(exact, 2e-4, 2e-4);  // about 3.2 degrees over 283 m
    EXPECT_GT(gap_m(drifted, exact), 2.0) << "the start is far off";
    const LoopClosureResult closed = close(drifted, thin(drive));
    EXPECT_GE(closed.n_closures, 2u);
    EXPECT_GT(closed.largest_m, 2.0);
    EXPECT_LT(gap_m(closed.track, exact), 0.1);
    for (std::size_t k = 1; k < exact.pose.size(); ++k) {  // no jumps between neighbouring poses
        const Pose step = inverse(closed.track.pose[k - 1]) * closed.track.pose[k],
                   was = inverse(exact.pose[k - 1]) * exact.pose[k];
        EXPECT_LT(glm::distance(step.translation, was.translation), 0.03) << "at " << k;
    }
}

TEST(CloseLoops, WhereNothingIsSeenAgainAllStays) {
    const Log log = make_street_log({.n_frames = 160, .rows = 32, .columns = 256});
    const auto scans = thin(log);
    const PoseTrack& exact = log.world_from_vehicle;
    EXPECT_EQ(close(exact, scans).n_closures, 0u);
    // Poses turn the street into a circle, but the scans at its ends differ.
    const PoseTrack circle = bend_track(exact, 2.0 * kPi / 120.0, 0.0);
    const LoopClosureResult closed = close(circle, scans);
    EXPECT_EQ(closed.n_closures, 0u) << "up to " << closed.largest_m << " m";
    for (std::size_t k = 0; k < exact.pose.size(); ++k)
        ASSERT_EQ(closed.track.pose[k].translation, circle.pose[k].translation);
}

}  // namespace
}  // namespace relidar
