// SPDX-License-Identifier: Apache-2.0
// A hall with exact wall positions, a sensor that drives and turns, and wrong poses.
#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include <relidar/registration/registration.hpp>

namespace relidar {
namespace {

// walls of the hall along x, y and z
constexpr double kSides_m[3][2] = {{-20.0, 25.0}, {-7.0, 9.0}, {-1.7, 6.0}};

SurfaceHit intersect_wall(const glm::dvec3& origin_m, const glm::dvec3& direction) {
    double nearest = std::numeric_limits<double>::infinity();
    SurfaceHit wall;
    for (int axis = 0; axis < 3; ++axis) {
        const double side = kSides_m[axis][direction[axis] > 0.0 ? 1 : 0],
                     t = (side - origin_m[axis]) / direction[axis];
        if (!(t < nearest)) continue;
        nearest = t;
        wall.point_m = origin_m + t * direction;
        wall.normal = glm::dvec3(0.0);
        wall.normal[axis] = direction[axis] > 0.0 ? -1.0 : 1.0;
    }
    return wall;
}

/// Each ray has a separate firing time, and no noise.
Log drive() {
    Log log;
    for (int k = 0; k < 3; ++k) {
        log.world_from_vehicle.time_s.push_back(0.1 * k);
        log.world_from_vehicle.pose.push_back(
            {make_rotation(0.05 * k, 0.01 * k, -0.01), {1.0 * k, 0.1 * k, 0.0}});
    }
    for (int k = 0; k < 3; ++k) {
        Frame frame{k, 0.1 * k, {}};
        for (int i = 0; i < 24 * 360; ++i) {
            const double azimuth = (i / 24) * kPi / 180.0 - kPi, elevation = (i % 24) * 0.02 - 0.3;
            frame.scan.rays.origin.emplace_back(0.0f);
            const glm::dvec2 level = std::cos(elevation) * glm::dvec2(std::cos(azimuth), std::sin(azimuth));
            frame.scan.rays.direction.emplace_back(level.x, level.y, std::sin(elevation));
            frame.scan.rays.time_offset_s.push_back(static_cast<float>(0.1 * azimuth / (2.0 * kPi)));
            frame.scan.rays.channel.push_back(0);
        }
        frame.scan.rays.rows = 1;
        frame.scan.rays.columns = 24 * 360;
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            const WorldRay ray =
                make_world_ray(log.world_from_vehicle, frame.time_s, frame.scan.rays, i, true);
            frame.scan.range_m.push_back(static_cast<float>(
                glm::distance(intersect_wall(ray.origin_m, ray.direction).point_m, ray.origin_m)));
            frame.scan.intensity.push_back(0.5f);
        }
        log.frames.push_back(std::move(frame));
    }
    return log;
}

ScanAlignment placed(const Log& log, std::size_t pose, const RegistrationOptions& options = {}) {
    return align_scan(
        log, pose,
        [&](int position, const std::vector<std::size_t>& rays, const PoseTrack& world_from_vehicle) {
            const Frame& frame = log.frames[std::size_t(position)];
            const PoseTrack world_from_sensor =
                mount_track(world_from_vehicle, log.lidar_of(frame).vehicle_from_sensor);
            std::vector<SurfaceHit> surface_hits;
            for (const std::size_t i : rays) {
                const WorldRay ray =
                    make_world_ray(world_from_sensor, frame.time_s, frame.scan.rays, i, true);
                surface_hits.push_back(intersect_wall(ray.origin_m, ray.direction));
            }
            return surface_hits;
        },
        {}, options);
}

double compute_angle_between(const Pose& first, const Pose& second) {
    const Twist twist = compute_twist(first, second);
    return glm::length(glm::dvec3(twist[3], twist[4], twist[5]));
}

TEST(PlaceScan, FindsThePoseOfOneSweepAmongOthersThatStay) {
    const Log exact = drive();
    std::mt19937_64 random(3);
    std::normal_distribution<double> metres(0.0, 0.02), radians(0.0, 2e-3);
    // The first and the last sweep have rays beyond the ends of the track.
    for (const std::size_t position : {0u, 1u, 2u}) {
        Log log = exact;
        Pose& pose = log.world_from_vehicle.pose[position];
        pose = apply_twist(pose, {metres(random), metres(random), metres(random), radians(random),
                                  radians(random), radians(random)});
        const ScanAlignment alignment = placed(log, position);
        const Pose& truth = exact.world_from_vehicle.pose[position];
        ASSERT_TRUE(alignment.is_aligned);
        EXPECT_LT(glm::distance(alignment.world_from_vehicle.translation, truth.translation), 1e-4)
            << position;
        EXPECT_LT(compute_angle_between(alignment.world_from_vehicle, truth), 1e-5) << position;
        EXPECT_NEAR(alignment.moved_m, glm::distance(pose.translation, truth.translation), 1e-4);
        EXPECT_GT(alignment.on_surfaces, 0.99);
    }
}

TEST(PlaceScan, ReturnsThatAreNoWallsHardlyPull) {
    const Log exact = drive();
    Log log = exact;
    // a quarter of the returns
    for (std::size_t i = 0; i < log.frames[1].scan.range_m.size(); i += 4)
        log.frames[1].scan.range_m[i] *= 0.6f;
    log.world_from_vehicle.pose[1].translation += glm::dvec3(0.01, -0.02, 0.01);
    const ScanAlignment alignment = placed(log, 1);
    ASSERT_TRUE(alignment.is_aligned);
    EXPECT_LT(
        glm::distance(alignment.world_from_vehicle.translation, exact.world_from_vehicle.pose[1].translation),
        1e-3);
    EXPECT_LT(alignment.on_surfaces, 0.9);
}

/// The LiDARs measure different surfaces: `first` has only the two side walls.
Log make_drive_of_two() {
    Log log = drive();
    const Pose mounted{make_rotation(0.4, 0.1, -0.05), {0.8, -0.3, 0.2}};
    log.lidars = {{"first", {}, {}}, {"second", {}, mounted}};
    std::vector<Frame> frames;
    const PoseTrack second = log.lidar_track(1);
    for (const Frame& frame : log.frames) {
        Frame other = frame;
        other.lidar = 1;
        frames.push_back(frame);
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            const WorldRay ray = make_world_ray(second, frame.time_s, frame.scan.rays, i, true),
                           first =
                               make_world_ray(log.world_from_vehicle, frame.time_s, frame.scan.rays, i, true);
            const SurfaceHit wall = intersect_wall(ray.origin_m, ray.direction);
            other.scan.range_m[i] =
                wall.normal.y == 0.0 ? static_cast<float>(glm::distance(wall.point_m, ray.origin_m)) : 0.0f;
            if (intersect_wall(first.origin_m, first.direction).normal.y == 0.0)
                frames.back().scan.range_m[i] = 0.0f;
        }
        frames.push_back(std::move(other));
    }
    log.frames = std::move(frames);
    return log;
}

TEST(PlaceScan, LidarsThatSweepTogetherArePlacedTogether) {
    const Log exact = make_drive_of_two();
    Log log = exact;
    Pose& pose = log.world_from_vehicle.pose[1];
    pose = apply_twist(pose, {0.02, -0.03, 0.02, 2e-3, -1e-3, 2e-3});
    const Pose& truth = exact.world_from_vehicle.pose[1];
    const ScanAlignment both = placed(log, 1);
    ASSERT_TRUE(both.is_aligned);
    EXPECT_LT(glm::distance(both.world_from_vehicle.translation, truth.translation), 5e-4)
        << "between poses the mounting turns on an arc, its track on a chord";
    EXPECT_LT(compute_angle_between(both.world_from_vehicle, truth), 1e-5);
    std::erase_if(log.frames, [](const Frame& frame) { return frame.lidar == 1; });
    EXPECT_GT(glm::distance(placed(log, 1).world_from_vehicle.translation, truth.translation), 0.01)
        << "side walls say nothing of the way";
}

TEST(PlaceScan, LeavesAScanThatIsNotFoundWhereItWas) {
    Log log = drive();
    log.world_from_vehicle.pose[1].translation.y += 0.04;
    RegistrationOptions strict;
    strict.largest_m = 0.01;
    const ScanAlignment far = placed(log, 1, strict);
    EXPECT_FALSE(far.is_aligned);
    EXPECT_EQ(far.world_from_vehicle.translation.y, log.world_from_vehicle.pose[1].translation.y);
    for (float& range_m : log.frames[1].scan.range_m) range_m = 0.5f;  // invalid ranges
    EXPECT_FALSE(placed(log, 1).is_aligned);
    for (float& range_m : log.frames[1].scan.range_m) range_m = 0.0f;  // no return
    EXPECT_FALSE(placed(log, 1).is_aligned);
}

}  // namespace
}  // namespace relidar
