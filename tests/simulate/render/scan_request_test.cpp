// SPDX-License-Identifier: Apache-2.0
// Tests scans for which the caller specifies the poses. The scene has walls and plates at
// exact positions, and the sensor follows an exact path.

#include <relidar/base/error.hpp>

#include "../../support/device.hpp"
#include "../plates.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
const glm::dvec3 kDatasetOrigin_m(455000.0, 5428000.0, 113.0);

/// A wall 10 m ahead, and a plate of 2 m perpendicular to its x axis. Both have returns.
Scene make_wall_and_car() {
    Scene scene;
    scene.surfels = test::make_plate({10.0f, 0.0f, 0.0f}, glm::vec2(5.0f));
    scene.surfels.append_surfels(test::make_plate({}, glm::vec2(1.0f)));
    scene.models = {{"background", 0, 1}, {"car", 1, 1}};
    scene.instances = {{0, ""}, {1, "car"}};
    return scene;
}

Log make_standing_log() {
    Log log = test::make_static_log({0.0}, 8);
    log.rolling_shutter = true;
    log.world_from_vehicle = {{0.0, 1.0}, {Pose{}, Pose{}}};
    log.world_offset_m = kDatasetOrigin_m;
    log.boxes = {{"car",
                  "Car",
                  {1, 2, 2},
                  {{0.0, 1.0}, {Pose{{1, 0, 0, 0}, {4, 0, 0}}, Pose{{1, 0, 0, 0}, {4, 0, 0}}}}}};
    return log;
}

Pose make_pose_at_x(double x_m) { return {{1, 0, 0, 0}, kDatasetOrigin_m + glm::dvec3(x_m, 0.0, 0.0)}; }

class ScanRequests : public test::DeviceTest {
protected:
    const Log log = make_standing_log();
    const SimulatedSensor sensor = make_sensor({}, log);
    std::optional<ScanRenderer> renderer;

    void SetUp() override {
        DeviceTest::SetUp();
        if (!IsSkipped() && !HasFatalFailure())
            renderer.emplace(device(), make_wall_and_car(), Config{}, log);
    }
    void TearDown() override {
        renderer.reset();
        DeviceTest::TearDown();
    }

    std::size_t ahead() const {
        for (std::size_t i = 0; i < sensor.rays.size(); ++i)
            if (sensor.rays.direction[i].x > 0.999f) return i;
        return sensor.rays.size();
    }
    double measure_range_ahead(const ScanRequest& request) {
        return double(renderer->render(sensor, request).median_range_m[ahead()]);
    }
    std::string refusal(const ScanRequest& request) {
        try {
            renderer->render(sensor, request);
        } catch (const DataError& error) {
            return error.what();
        }
        return "";
    }
};

TEST_F(ScanRequests, SensorIsWhereTheCallerHasIt) {
    EXPECT_NEAR(measure_range_ahead({0.5, {{0.0}, {make_pose_at_x(1.0)}}, ActorTracksByName{}}), 9.0, 1e-4)
        << "one pose: it stands; no actor is given: none is there";
    const RenderedScan scan = renderer->render(sensor, {0.5, {{0.0}, {make_pose_at_x(1.0)}}});
    EXPECT_EQ(scan.world_from_sensor.translation, make_pose_at_x(1.0).translation);
    EXPECT_NEAR(scan.median_range_m[ahead()], 3.0, 1e-4) << "actors as the log has them";
}

TEST_F(ScanRequests, EachRayIsFiredFromWhereTheSensorIsThen) {
    const PoseTrack sensor_path{{0.0, 2.0}, {make_pose_at_x(-4.0), make_pose_at_x(0.0)}};  // 2 m/s
    const double fired_s = 1.0 + double(sensor.rays.time_offset_s[ahead()]);
    ASSERT_NE(sensor.rays.time_offset_s[ahead()], sensor.rays.time_offset_s[0]) << "the sensor turns";
    EXPECT_NEAR(measure_range_ahead({1.0, sensor_path, ActorTracksByName{}}), 10.0 + 4.0 - 2.0 * fired_s,
                1e-4);
    const RenderedScan scan = renderer->render(sensor, {1.0, sensor_path, ActorTracksByName{}});
    for (std::size_t i = 0; i < scan.median_range_m.size(); ++i) {
        if (!(scan.median_range_m[i] > 0.0f)) continue;
        const glm::dvec3 point =
            scan.firing_pose(i) *
            glm::dvec3(scan.image.origin[i] + scan.median_range_m[i] * scan.image.direction[i]);
        EXPECT_NEAR(point.x, kDatasetOrigin_m.x + 10.0, 1e-4) << "ray " << i;
    }
}

TEST_F(ScanRequests, ActorsAreWhereTheCallerHasThem) {
    const PoseTrack stands{{0.0}, {make_pose_at_x(0.0)}};
    EXPECT_NEAR(
        measure_range_ahead({0.5, stands, ActorTracksByName{{"car", {{0.0}, {make_pose_at_x(6.0)}}}}}), 6.0,
        1e-4);
    const double faced_s = 0.5;  // time at which a sweep with time stamp 0.5 s faces straight ahead
    EXPECT_NEAR(measure_range_ahead(
                    {0.5, stands,
                     ActorTracksByName{{"car", {{0.0, 1.0}, {make_pose_at_x(5.0), make_pose_at_x(8.0)}}}}}),
                5.0 + 3.0 * faced_s, 1e-4);
    EXPECT_NEAR(
        measure_range_ahead({70.0, stands, ActorTracksByName{{"car", {{0.0}, {make_pose_at_x(6.0)}}}}}), 6.0,
        1e-4)
        << "the log's time does not bind the caller";
    EXPECT_NEAR(measure_range_ahead({70.0, stands}), 10.0, 1e-4) << "and its own actors have left by then";
    EXPECT_NEAR(measure_range_ahead({0.5, stands}), 4.0, 1e-4);
}

TEST_F(ScanRequests, WhatMakesNoSenseIsRefused) {
    EXPECT_THAT(refusal({0.0, {}}), test::Names("sensor ... 0 ... 0"));
    EXPECT_THAT(refusal({0.0, {{0.0, 1.0}, {make_pose_at_x(0)}}}), test::Names("sensor ... 1 ... 2"));
    EXPECT_THAT(refusal({0.0, {{1.0, 1.0}, {make_pose_at_x(0), make_pose_at_x(1)}}}),
                test::Names("time 1 s ... 1 s"));
    EXPECT_THAT(refusal({0.0, {{0.0}, {make_pose_at_x(kNan)}}}), test::Names("pose ... entry 0"));
    EXPECT_NE(refusal({0.0, {{0.0}, {make_pose_at_x(1e300)}}}).find("entry 0"), std::string::npos);
    EXPECT_NE(refusal({0.0, {{kNan}, {make_pose_at_x(0)}}}).find("entry 0"), std::string::npos);
    EXPECT_THAT(refusal({0.0, {{0.0}, {Pose{{2, 0, 0, 0}, {}}}}}), test::Names("quaternion"));
    EXPECT_NE(refusal({kNan, {{0.0}, {make_pose_at_x(0)}}}).find("time_s: found nan"), std::string::npos);
    EXPECT_THAT(refusal({0.0, {{0.0}, {make_pose_at_x(0)}}, ActorTracksByName{{"car", {}}}}),
                test::Names("car ... 0"));
    SimulatedSensor slow = sensor;  // a sweep of 1000 s on a path of 1.2 s
    for (std::size_t i = 0; i < slow.rays.size(); ++i) slow.rays.time_offset_s[i] *= 10000.0f;
    EXPECT_THROW(renderer->render(slow, {0.5, {{0.0, 1.2}, {make_pose_at_x(0), make_pose_at_x(1)}}}),
                 DataError);
    EXPECT_NO_THROW(renderer->render(slow, {0.5, {{0.0}, {make_pose_at_x(0)}}}));  // the sensor stands
    EXPECT_THROW(
        measure_range_ahead(
            {0.0, {{0.0}, {make_pose_at_x(0)}}, ActorTracksByName{{"cat", {{0.0}, {make_pose_at_x(0)}}}}}),
        UsageError);
}

}  // namespace
}  // namespace relidar
