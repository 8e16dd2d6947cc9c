// SPDX-License-Identifier: Apache-2.0
// Tests the alignment of held-out scans with a trained street. The test compares with
// exact poses.

#include <relidar/read/dataset.hpp>
#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>

#include "../support/device.hpp"

namespace relidar {
namespace {

class PlaceHeldOut : public test::DeviceTest {};

Run train_small_run(Device& device) {
    Run run;
    run.sequence =
        make_street_log({.seed = 7, .n_frames = 12, .rows = 32, .columns = 512, .range_noise_m = 0.01});
    run.split = split_frames(run.sequence, 4);
    run.config = make_preset("quick");
    run.config.train.iterations = 60;
    run.config.train.rays_per_iteration = 4096;
    run.config.train.refine_poses = "none";
    run.scene = train(device, run.sequence, run.split, run.config).scene;
    run.config.train.refine_poses = "sensor";
    return run;
}

Run move_run(Device& device, const Twist& off) {
    static const Run trained = train_small_run(device);
    Run run = trained;
    for (const int k : run.split.test) {
        Pose& pose = run.sequence.world_from_vehicle.pose[std::size_t(k)];
        pose = apply_twist(pose, off);
    }
    return run;
}

TEST_F(PlaceHeldOut, FindsWhereTheyWereAndMovesNothingElse) {
    const PoseTrack exact =
        make_street_log({.seed = 7, .n_frames = 12, .rows = 2, .columns = 8}).world_from_vehicle;
    const Twist off{0.03, -0.02, 0.02, 1e-3, -2e-3, 2e-3};
    relidar::Run run = move_run(device(), off);
    const relidar::Run before = run;
    const HeldOutPoseReport placed = register_held_out(device(), run);
    ASSERT_EQ(placed.scans, run.split.test.size());
    EXPECT_TRUE(run.held_out_placed);
    EXPECT_EQ(placed.placed, placed.scans);
    const double off_m = glm::length(glm::dvec3(off[0], off[1], off[2]));
    EXPECT_NEAR(placed.median_m, off_m, 0.006);
    for (const int k : run.split.test) {
        const auto i = std::size_t(k);
        const Twist left = compute_twist(exact.pose[i], run.sequence.world_from_vehicle.pose[i]);
        EXPECT_LT(glm::length(glm::dvec3(left[0], left[1], left[2])), 0.006) << "frame " << k;
        EXPECT_LT(glm::length(glm::dvec3(left[3], left[4], left[5])), 5e-4) << "frame " << k;
    }
    for (const int k : run.split.train)
        EXPECT_EQ(run.sequence.world_from_vehicle.pose[std::size_t(k)].translation,
                  before.sequence.world_from_vehicle.pose[std::size_t(k)].translation);
    relidar::Run again = before;
    register_held_out(device(), again);
    for (const int k : run.split.test)
        EXPECT_EQ(again.sequence.world_from_vehicle.pose[std::size_t(k)].translation,
                  run.sequence.world_from_vehicle.pose[std::size_t(k)].translation);
}

TEST_F(PlaceHeldOut, DoesNothingWhereItIsNotAskedForOrStopped) {
    relidar::Run run = move_run(device(), {0.03, 0.0, 0.0, 0.0, 0.0, 0.0});
    const std::vector<Pose> before = run.sequence.world_from_vehicle.pose;
    const auto stays = [&] {
        for (std::size_t k = 0; k < before.size(); ++k)
            if (run.sequence.world_from_vehicle.pose[k].translation != before[k].translation) return false;
        return true;
    };
    int n_stop_calls = 0;
    EXPECT_EQ(register_held_out(device(), run, {{}, [&] { return ++n_stop_calls > 1; }}).scans, 0u);
    EXPECT_TRUE(stays()) << "stopped at the second scan";
    EXPECT_FALSE(run.held_out_placed);
    run.config.train.place_held_out = false;
    EXPECT_EQ(register_held_out(device(), run).scans, 0u);
    EXPECT_TRUE(stays());
    EXPECT_TRUE(run.held_out_placed) << "it was asked, and there was nothing to do";
    run.config.train.place_held_out = true;
    run.config.train.pose_register = false;
    EXPECT_EQ(register_held_out(device(), run).scans, 0u);
    EXPECT_TRUE(stays());
}

}  // namespace
}  // namespace relidar
