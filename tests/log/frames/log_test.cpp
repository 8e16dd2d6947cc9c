// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/log_time.hpp>

#include <cmath>
#include <random>

#include <relidar/base/error.hpp>

#include "support/names.hpp"

namespace relidar {
namespace {

Pose make_turned_pose(double yaw, const glm::dvec3& t) {
    return {glm::angleAxis(yaw, glm::dvec3(0, 0, 1)), t};
}

double yaw_of(const Pose& pose) {
    const glm::dvec3 x = pose.rotation * glm::dvec3(1, 0, 0);
    return std::atan2(x.y, x.x);
}

Log make_log_from(double first_s) {
    Log log;
    log.lidars[0].sensor.period_s = 0.1;
    for (const int i : {0, 1}) log.frames.push_back({.index = i, .time_s = first_s + 0.1 * i, .scan = {}});
    return log;
}

TEST(LogTime, TheShiftIsTheDateOrTheFewestWholeSeconds) {
    constexpr std::int64_t kSecond_ns = 1'000'000'000;
    const auto shift = [](double first_s) { return time_shift_of(make_log_from(first_s)); };
    EXPECT_EQ(shift(10.3), 0) << "no stamp is negative";
    EXPECT_EQ(shift(0.0), kSecond_ns);
    EXPECT_EQ(shift(-1000.0), 1001 * kSecond_ns);
    EXPECT_EQ(shift(1.7e9), 0) << "the times of the log are dates";
    EXPECT_EQ(time_shift_of(make_log_from(10.0), -2.5), 3 * kSecond_ns) << "scans before the log";
    EXPECT_EQ(time_shift_of(make_log_from(0.0), 2.0), 0) << "no scan is before 0 s";
    EXPECT_EQ(time_shift_note(make_log_from(10.0), 0), "");
    EXPECT_THAT(time_shift_note(make_log_from(-1000.0), shift(-1000.0)), test::Names("1001 s later"));
    const std::int64_t start_ns = 1317042145594360375;
    Log dated = make_log_from(-5.0);
    set_log_start(dated, start_ns, "on a clock");
    EXPECT_EQ(dated.conventions, " Time 0 s is 1317042145.594360375 s on a clock.");
    EXPECT_EQ(time_shift_of(dated), start_ns) << "a log with a date keeps it";
    EXPECT_EQ(time_shift_note(dated, start_ns), "");
    Log booted = make_log_from(0.0);
    booted.start_unix_ns = 40'000'000;
    EXPECT_EQ(time_shift_of(booted), 40'000'000 + kSecond_ns) << "a clock that starts at 0";
}

TEST(PoseTrack, InterpolatesAndContinuesAtTheEnds) {
    const PoseTrack track{{0.0, 1.0, 3.0},
                          {make_turned_pose(0.0, {0, 0, 0}), make_turned_pose(0.2, {1, 0, 0}),
                           make_turned_pose(0.2, {1, 4, 0})}};
    EXPECT_NEAR(track.pose_at(0.5).translation.x, 0.5, 1e-12);
    EXPECT_NEAR(yaw_of(track.pose_at(0.5)), 0.1, 1e-9);
    EXPECT_NEAR(track.pose_at(2.0).translation.y, 2.0, 1e-12);
    EXPECT_NEAR(track.pose_at(-0.5).translation.x, -0.5, 1e-12);
    EXPECT_NEAR(yaw_of(track.pose_at(-0.5)), -0.1, 1e-9);
    EXPECT_NEAR(track.pose_at(3.5).translation.y, 5.0, 1e-12);
    EXPECT_THROW(PoseTrack{}.pose_at(0.0), DataError);
    const PoseTrack one{{2.0}, {make_turned_pose(0.3, {1, 2, 3})}};
    EXPECT_NEAR(one.pose_at(7.0).translation.z, 3.0, 1e-12);
}

TEST(PoseTrack, WhatIsMountedGoesRoundBendsOfFineTurns) {
    const PoseTrack track{{0.0, 1.0, 1.5, 3.0},
                          {make_turned_pose(0.0, {0, 0, 0}), make_turned_pose(0.8, {1, 0, 0}),
                           make_turned_pose(0.8, {2, 0, 1}), make_turned_pose(-0.4, {1, 4, 0})}};
    const PoseTrack fine = subdivide_turns(track);
    const Pose mounted = make_turned_pose(0.3, {2, 1, 0.5});
    const PoseTrack coarse_ride = mount_track(track, mounted), ride = mount_track(fine, mounted);
    double largest_m = 0.0, coarse_m = 0.0;
    for (double t = 0.0; t <= 3.0; t += 0.01) {
        EXPECT_LT(glm::distance(fine.pose_at(t).translation, track.pose_at(t).translation), 1e-12)
            << "the same path at " << t;
        EXPECT_NEAR(yaw_of(fine.pose_at(t)), yaw_of(track.pose_at(t)), 1e-9);
        const glm::dvec3 truth = (track.pose_at(t) * mounted).translation;
        largest_m = std::max(largest_m, glm::distance(ride.pose_at(t).translation, truth));
        coarse_m = std::max(coarse_m, glm::distance(coarse_ride.pose_at(t).translation, truth));
    }
    EXPECT_LT(largest_m, 1e-5);
    EXPECT_GT(coarse_m, 0.1) << "along chords";
    EXPECT_EQ(fine.time_s.size(), fine.pose.size());
    EXPECT_TRUE(subdivide_turns({}).pose.empty());
    const PoseTrack straight{{0.0, 1.0},
                             {make_turned_pose(0.2, {0, 0, 0}), make_turned_pose(0.2, {9, 0, 0})}};
    EXPECT_EQ(subdivide_turns(straight).pose.size(), 2u) << "straight on needs none";
}

TEST(SensorPoses, BoxesStayWhereTheSensorSawThem) {
    const auto turned = [](double angle, const glm::dvec3& t) {
        return Pose{glm::angleAxis(angle, glm::normalize(glm::dvec3(1, 2, 3))), t};
    };
    Log log;
    log.world_from_vehicle = {{0.0, 1.0}, {turned(0.1, {0, 0, 0}), turned(0.3, {8, 1, 0})}};
    log.boxes.push_back(
        {"0", "Car", {4, 2, 1.5}, {{0.25, 1.0}, {turned(0.7, {10, 3, 0}), turned(0.9, {15, 3, 1})}}});
    const Log before = log;
    const PoseTrack track{{0.0, 1.0}, {turned(0.2, {0.3, -0.2, 0.1}), turned(0.25, {8.1, 1.4, 0.2})}};
    set_trajectory(log, track);
    EXPECT_EQ(log.world_from_vehicle.pose[1].translation, track.pose[1].translation);
    for (std::size_t k = 0; k < 2; ++k) {
        const auto in_vehicle = [&](const Log& moved) {
            const PoseTrack& box = moved.boxes[0].world_from_box;
            return inverse(moved.world_from_vehicle.pose_at(box.time_s[k])) * box.pose[k];
        };
        const Pose first = in_vehicle(before), second = in_vehicle(log);
        EXPECT_LT(glm::distance(first.translation, second.translation), 1e-12);
        EXPECT_NEAR(std::abs(glm::dot(first.rotation, second.rotation)), 1.0, 1e-12);
        EXPECT_GT(glm::distance(before.boxes[0].world_from_box.pose[k].translation,
                                log.boxes[0].world_from_box.pose[k].translation),
                  0.1);
    }
}

TEST(WorldRay, UsesThePoseAtTheRaysOwnTime) {
    const PoseTrack track{{0.0, 1.0}, {make_turned_pose(0.0, {0, 0, 0}), make_turned_pose(0.0, {10, 0, 0})}};
    RayTable rays;
    rays.origin = {{0, 0, 0.2f}};
    rays.direction = {{0, 1, 0}};
    rays.time_offset_s = {0.05f};
    const WorldRay rolling = make_world_ray(track, 0.5, rays, 0, true),
                   global = make_world_ray(track, 0.5, rays, 0, false);
    EXPECT_NEAR(rolling.origin_m.x, 5.5, 1e-6);
    EXPECT_NEAR(global.origin_m.x, 5.0, 1e-12);
    EXPECT_NEAR(rolling.origin_m.z, 0.2, 1e-6);
}

/// The labels vary by 9 cm, as in KITTI.
BoxTrack driven(int count, double speed_mps, double step_s = 0.1) {
    BoxTrack box;
    box.size_m = {4.4, 1.8, 1.6};
    for (int i = 0; i < count; ++i)
        box.world_from_box.append(step_s * i,
                                  make_turned_pose(0.0, {step_s * i * speed_mps, i % 2 ? 0.045 : -0.045, 0}));
    return box;
}

TEST(MovingBox, IsNoneThatDriftsNoFasterThanPosesDo) {
    EXPECT_FALSE(BoxTrack{}.is_moving());
    for (const int n : {1, 2, 95}) EXPECT_FALSE(driven(n, 0.0).is_moving()) << n;
    EXPECT_FALSE(driven(95, 0.18).is_moving()) << "1.7 m of drift while it is seen";
    EXPECT_TRUE(driven(95, 0.3).is_moving()) << "2.5 m are more than drift";
    EXPECT_TRUE(driven(30, 8.0).is_moving());
    EXPECT_TRUE(driven(2, 8.0).is_moving()) << "seen twice";
    BoxTrack starts = driven(95, 0.0);  // a car that waits, then moves 1.6 m in the last second
    for (std::size_t i = 85; i < 95; ++i)
        starts.world_from_box.pose[i].translation.x += 0.02 * double((i - 85) * (i - 85));
    EXPECT_TRUE(starts.is_moving());
    BoxTrack walker = driven(95, 0.1), hurried = driven(6, 1.2);
    walker.size_m = hurried.size_m = {0.7, 0.6, 1.8};
    EXPECT_TRUE(walker.is_moving()) << "0.9 m are more than its size, however slow";
    EXPECT_TRUE(hurried.is_moving()) << "for half a second";
}

/// As in nuScenes, labels are set twice a second and interpolated to 20 sweeps a second.
TEST(MovingBox, IsNoneThatJittersHoweverOftenItIsLabelled) {
    std::mt19937 random(3);
    std::uniform_real_distribution<double> off(-0.1, 0.1);
    for (int things = 0; things < 200; ++things) {
        PoseTrack keyframes;
        const int n = 2 + things % 12;
        for (int k = 0; k < n; ++k)
            keyframes.append(0.5 * k,
                             make_turned_pose(0.3, {10.0 + off(random), 5.0 + off(random), off(random)}));
        BoxTrack parked{"p", "car", {4.4, 1.8, 1.6}, {}}, driving = parked;
        for (int i = 0; i <= 10 * (n - 1); ++i) {
            for (BoxTrack* box : {&parked, &driving})
                box->world_from_box.append(0.05 * i, keyframes.pose_at(0.05 * i));
            driving.world_from_box.pose.back().translation.x += 2.0 * 0.05 * i;
        }
        EXPECT_FALSE(parked.is_moving()) << n << " keyframes";
        EXPECT_TRUE(driving.is_moving()) << n << " keyframes";
    }
}

TEST(MovingBox, OnlyMovingBoxesAtTheirTimes) {
    BoxTrack car;
    car.size_m = {4, 2, 1.5};
    car.world_from_box = {{0.0, 0.1, 0.2},
                          {make_turned_pose(kPi / 2, {0, 0, 0}), make_turned_pose(kPi / 2, {0, 1, 0}),
                           make_turned_pose(kPi / 2, {0, 2, 0})}};
    // The length is along y: centre 0.5, half size 2.
    EXPECT_TRUE(is_in_moving_box({car}, {0.9, 2.4, 0.0}, 0.05, 0.0));
    EXPECT_FALSE(is_in_moving_box({car}, {1.1, 2.4, 0.0}, 0.05, 0.0));
    EXPECT_TRUE(is_in_moving_box({car}, {1.1, 2.4, 0.0}, 0.05, 0.2));
    BoxTrack parked = car;
    for (Pose& pose : parked.world_from_box.pose) pose.translation = {};
    EXPECT_FALSE(is_in_moving_box({parked}, {0.0, 0.5, 0.0}, 0.05, 0.0));
    EXPECT_TRUE(is_in_moving_box({car}, {0.0, 0.0, 0.0}, -0.04, 0.0));  // the sweep of the first label
    EXPECT_FALSE(is_in_moving_box({car}, {0.0, 0.0, 0.0}, -0.06, 0.0));
}

RayTable make_turning_rays(const SpinningSensor& sensor, double from_rad, double from_s, int count) {
    RayTable rays;
    rays.rows = 1;
    rays.columns = count;
    for (int i = 0; i < count; ++i) {
        const double azimuth = from_rad + (sensor.clockwise ? -1.0 : 1.0) * 2.0 * kPi * i / 500.0;
        rays.direction.emplace_back(std::cos(azimuth), std::sin(azimuth), 0.0);
        rays.time_offset_s.push_back(static_cast<float>(from_s + sensor.period_s * i / 500.0));
    }
    return rays;
}

TEST(SweepStart, AHeadFacesAThingWhenItsRayIsFired) {
    Log log;
    SpinningSensor& sensor = log.lidars[0].sensor;
    for (const bool clockwise : {true, false}) {
        sensor.clockwise = clockwise;
        for (const double from_rad : {-2.5, 0.3, 2.0}) {
            for (const double from_s : {-0.05, -0.099, 0.003}) {
                const RayTable rays = make_turning_rays(sensor, from_rad, from_s, 500);
                const auto start = find_sweep_start(rays, sensor);
                ASSERT_TRUE(start.has_value());
                for (std::size_t i = 1; i < 500; i += 7) {
                    const double facing_s =
                        facing_time_s(log, 9.0 * glm::dvec3(rays.direction[i]), {100.0, 0, start});
                    ASSERT_NEAR(facing_s, 100.0 + double(rays.time_offset_s[i]), 1e-6)
                        << from_rad << " " << from_s << " " << i;
                }
            }
        }
    }
}

TEST(SweepStart, AWindowFacesAThingWhenItsColumnIsFired) {
    const WindowScanSensor window{.name = "w",
                                  .rows = 2,
                                  .columns = 40,
                                  .left_rad = 1.0,
                                  .right_rad = -0.8,
                                  .top_rad = 0.1,
                                  .bottom_rad = 0.0,
                                  .period_s = 0.08};
    Log log;
    log.lidars[0].sensor.period_s = 0.0;
    log.lidars[0].pattern = window;
    // The time of the frame is in the middle of the scan, at its start, or after its end.
    for (const float later_s : {0.0f, 0.04f, -0.1f}) {
        RayTable rays = make_rays(window);
        for (float& t : rays.time_offset_s) t += later_s;
        const auto start = find_sweep_start(rays, log.lidars[0]);
        EXPECT_EQ(start.has_value(), later_s != 0.0f);
        for (std::size_t i = 0; i < rays.size(); ++i)
            ASSERT_NEAR(facing_time_s(log, 5.0 * glm::dvec3(rays.direction[i]), {7.0, 0, start}),
                        7.0 + double(rays.time_offset_s[i]), 1.1e-3)
                << "half a column: " << later_s << " " << i;
    }
    EXPECT_EQ(make_lidar_rays(log.lidars[0], 3.0).direction, make_rays(window).direction);
    const RosetteSensor rosette{
        .name = "r", .deflection_rad = 0.1, .first_hz = 30.0, .second_hz = -20.0, .n_rays = 50};
    log.lidars[0].pattern = rosette;
    EXPECT_EQ(facing_time_s(log, {3, 1, 0}, {7.0, 0, {}}), 7.0);
    EXPECT_EQ(facing_time_s(log, {3, 1, 0}, {7.0, 0, SweepStart{0.0, 0.0}}), 7.05);
    EXPECT_EQ(make_lidar_rays(log.lidars[0], 3.3).direction, make_rays(rosette, 3.3).direction);
}

TEST(SweepStart, TheUsualOneIsNoneAndNothingIsMadeUp) {
    SpinningSensor sensor;
    EXPECT_FALSE(find_sweep_start(make_turning_rays(sensor, kPi, -0.05, 500), sensor).has_value());
    EXPECT_TRUE(find_sweep_start(make_turning_rays(sensor, kPi, 0.0, 500), sensor).has_value());
    RayTable at_once = make_turning_rays(sensor, 0.0, 0.0, 500);
    for (float& t : at_once.time_offset_s) t = 0.0f;
    EXPECT_FALSE(find_sweep_start(at_once, sensor).has_value()) << "all rays of one moment";
    sensor.period_s = 0.0;
    EXPECT_FALSE(find_sweep_start(at_once, sensor).has_value());
}

Log make_numbered_frames(int first, int end) {
    Log log;
    for (int i = first; i < end; ++i) log.frames.emplace_back().index = i;
    return log;
}

TEST(Split, EveryTenthOfFiftyButTheFirst) {
    const Log log = make_numbered_frames(0, 50);
    const Split split = split_frames(log, 10);
    EXPECT_EQ(split.test, (std::vector<int>{10, 20, 30, 40}));
    EXPECT_EQ(split.train.size(), 46u);
    EXPECT_EQ(split_frames(log, 0).train.size(), 50u);
    EXPECT_THROW(split_frames(log, 1), UsageError);
    EXPECT_EQ(split_frames(log, 0, "13,26,40:45").test, (std::vector<int>{13, 26, 40, 41, 42, 43, 44}));
}

TEST(Split, APublishedPartHoldsOutWhatIsPublished) {
    Log log = make_numbered_frames(2351, 2401);
    log.frames.erase(log.frames.begin() + 4);  // a frame without a pose shifts no index
    log.test_frames = {2360, 2370, 2380, 2390};
    const auto indices = [&](const Split& split) {
        std::vector<int> all;
        for (const int position : split.test) all.push_back(log.frames[std::size_t(position)].index);
        return all;
    };
    EXPECT_EQ(indices(split_frames(log, 10)), log.test_frames);
    EXPECT_EQ(indices(split_frames(log, 10, "2353,2400")), (std::vector<int>{2353, 2400}));
    EXPECT_TRUE(split_frames(log, 0).test.empty());
    EXPECT_EQ(split_frames(log, 25).test.size(), 1u) << "another number is another split";
}

/// Makes the frames 100, 103, 106 ... of two LiDARs. The second has no sweep 106.
Log make_sweeps_of_three() {
    Log log;
    for (int i = 0; i < 8; ++i) {
        for (int lidar = 0; lidar < 2; ++lidar) {
            if (i == 2 && lidar == 1) continue;
            Frame& frame = log.frames.emplace_back();
            frame.index = 100 + 3 * i;
            frame.lidar = lidar;
        }
    }
    return log;
}

TEST(Split, NamedSweepsAreHeldOutWithAllTheirLidars) {
    const Log log = make_sweeps_of_three();
    const auto held_out = [&](const std::string& list) {
        const Split split = split_frames(log, 10, list);
        std::vector<int> all = split.train;
        all.insert(all.end(), split.test.begin(), split.test.end());
        std::sort(all.begin(), all.end());
        for (std::size_t i = 0; i < all.size(); ++i)
            EXPECT_EQ(all[i], int(i)) << list << ": every frame is in one part";
        EXPECT_EQ(all.size(), log.frames.size());
        return split.test;
    };
    EXPECT_EQ(held_out("100"), (std::vector<int>{0, 1})) << "the first one, too, and test_every has no say";
    EXPECT_EQ(held_out("121, 103"), (std::vector<int>{2, 3, 13, 14})) << "in any order";
    EXPECT_EQ(held_out("106"), std::vector<int>{4});
    EXPECT_EQ(held_out(""), std::vector<int>{}) << "fewer than ten sweeps";
    EXPECT_EQ(split_frames(log, 1, "109").test, (std::vector<int>{5, 6}));
}

TEST(Split, ListsThatNameNoPartOfTheLogAreRefused) {
    const Log log = make_sweeps_of_three();
    const auto refused = [&](const std::string& list, const std::string& why) {
        EXPECT_THAT([&] { split_frames(log, 10, list); },
                    testing::ThrowsMessage<UsageError>(test::Names("dataset.test_frames ... " + why)))
            << list;
    };
    refused("104", "frame 104 ... 100, 103, 106, 109, 112, ... 121 (8");
    refused("100:104", "frame 101");
    refused("100:99999999", "frame 101");
    refused("103,103", "frame 103 ... twice");
    refused("100:101,100", "frame 100 ... twice");
    refused("100,103,106,109,112,115,118,121", "100, 103, 106, 109, 112, ... 121 (8");
    for (const char* bad : {"x", "-3", "1e2", "100,", ",", " ", "1 03", "103:100", "100:100", "100:", ":103",
                            "1:2:3", "123456789"})
        refused(bad, "");
    refused("100,ten", "\"ten\"");
}

TEST(BoxTrack, KnowsWhatOfItWasLabelled) {
    BoxTrack car{"1", "Car", {4, 2, 1.5}, {}};
    for (int i = 0; i < 6; ++i) car.world_from_box.append(0.1 * i, {{}, {double(i), 0.0, 0.0}});
    EXPECT_EQ(car.labelled_part().world_from_box.time_s, car.world_from_box.time_s);
    car.n_before = 2;
    car.n_after = 1;
    const PoseTrack labelled = car.labelled_part().world_from_box;
    EXPECT_EQ(labelled.time_s, (std::vector<double>{0.1 * 2, 0.1 * 3, 0.1 * 4}));
    EXPECT_EQ(labelled.pose.front().translation.x, 2.0);
    EXPECT_EQ(car.labelled_part().n_before + car.labelled_part().n_after, 0u);
}

}  // namespace
}  // namespace relidar
