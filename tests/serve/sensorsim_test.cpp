// SPDX-License-Identifier: Apache-2.0
// The expected positions of the points follow from the poses only.
#include <set>

#include <gmock/gmock.h>
#include <grpcpp/impl/client_unary_call.h>

#include <relidar/log/sensor_files.hpp>

#include "sensorsim/sensorsim.grpc.pb.h"
#include "small_service.hpp"
#include "support/names.hpp"

namespace relidar::serve {
namespace {

namespace wire = nre::grpc::protos::sensorsim;
using test::Names;
using Code = grpc::StatusCode;

void set_pair(wire::PosePair& message, const Pose& start, const Pose& end) {
    write_pose(start, *message.mutable_start());
    write_pose(end, *message.mutable_end());
}

/// Poses in the world of the protocol. The sensor first looks along x. In 0.1 s, it moves
/// 1.5 m ahead and turns by 0.25 rad to the left.
const Pose kStart{{1, 0, 0, 0}, {-1.5, 0.0, 0.0}};
const Pose kEnd{make_rotation(0.25, 0.0, 0.0), {0.0, 0.5, 0.0}};

wire::LidarRenderRequest moving() {
    wire::LidarRenderRequest request;
    request.set_scene_id("small");
    request.set_frame_start_us(400'000);
    request.set_frame_end_us(500'000);
    set_pair(*request.mutable_sensor_pose(), kStart, kEnd);
    return request;
}

wire::DynamicObject& add_car(wire::LidarRenderRequest& request, const Pose& start, const Pose& end) {
    wire::DynamicObject& car = *request.add_dynamic_objects();
    car.set_track_id("car");
    set_pair(*car.mutable_pose(), start, end);
    return car;
}

class Sensorsim : public ServiceTest {
protected:
    using Stub = wire::SensorsimService::Stub;
    std::unique_ptr<Stub> calls;

    void start_sensorsim(PoseTransformOrder order = PoseTransformOrder::rotation_first) {
        sensorsim = order;
        start();
        calls = wire::SensorsimService::NewStub(open_channel(address()));
    }
    wire::LidarRenderReturn render(const wire::LidarRenderRequest& request) {
        const auto [status, answer] = call(*calls, &Stub::render_lidar, request);
        EXPECT_TRUE(status.ok()) << status.error_message();
        return answer;
    }
    grpc::Status refused(const wire::LidarRenderRequest& request) {
        return call(*calls, &Stub::render_lidar, request).status;
    }
    /// Returns x of each point in the world of the protocol, for a sensor that has the
    /// pose `end`.
    static std::vector<double> world_x(const wire::LidarRenderReturn& scan, const Pose& end) {
        std::vector<double> x_m;
        for (const glm::vec3& point : values<glm::vec3>(scan.xyz_buffer()))
            x_m.push_back((end * glm::dvec3(point)).x);
        return x_m;
    }
};

MATCHER_P(LiesAt, x_m, "") { return std::abs(arg - x_m) < 2e-3; }

TEST_F(Sensorsim, PointsLieOnTheWallSeenFromTheEndOfTheSpin) {
    start_sensorsim();
    const wire::LidarRenderReturn scan = render(moving());
    ASSERT_GT(scan.count(), 1000u);
    EXPECT_THAT(world_x(scan, kEnd), testing::Each(LiesAt(10.0)))
        << "no actor is named: the plate ahead of the wall is not there";
    EXPECT_EQ(scan.xyz_size(), 3 * int(scan.count()));
    EXPECT_EQ(scan.intensities_size(), int(scan.count()));
    EXPECT_EQ(values<float>(scan.xyz_buffer()), std::vector<float>(scan.xyz().begin(), scan.xyz().end()));
    EXPECT_EQ(values<float>(scan.intensity_buffer()),
              std::vector<float>(scan.intensities().begin(), scan.intensities().end()));
    EXPECT_THAT(scan.intensities(), testing::Each(testing::AllOf(testing::Ge(0.0f), testing::Le(1.0f))));
}

/// Returns the angle in radians between a beam and a point on the wall, assuming that the
/// beam measured the point. The head turns at constant speed and faces backward at the
/// start and at the end of the frame. The position of the sensor follows from the
/// azimuth.
double measure_distance_to_beam(const Beam& beam, const glm::dvec3& on_wall, double driven_length_m) {
    double at_x_m = 0.5 * driven_length_m, elevation = 0.0;
    for (int round = 0; round < 8; ++round) {
        const double ahead_m = on_wall.x - at_x_m;
        elevation = std::atan2(on_wall.z, std::hypot(ahead_m, on_wall.y));
        at_x_m = (kPi - (std::atan2(on_wall.y, ahead_m) - beam.azimuth_offset_rad)) / (2.0 * kPi) *
                 driven_length_m;
    }
    return std::abs(elevation - beam.elevation_rad);
}

TEST_F(Sensorsim, SweepFillsTheFrameFromItsStartToItsEnd) {
    start_sensorsim();
    const std::vector<Beam> beams = std::get<SpinningSensor>(find_sensor("Pandar128").pattern).beams;
    constexpr double kDriveLength_m = 8.0;
    for (const std::uint64_t frame_us : {100'000u, 3'000'000u}) {
        wire::LidarRenderRequest request = moving();
        request.set_frame_end_us(400'000 + frame_us);
        set_pair(*request.mutable_sensor_pose(), {}, {{1, 0, 0, 0}, {kDriveLength_m, 0.0, 0.0}});
        const auto points = values<glm::vec3>(render(request).xyz_buffer());
        ASSERT_GT(points.size(), 1000u);
        double worst = 0.0;
        for (std::size_t i = 0; i < points.size(); i += 7) {  // 7 does not divide the number of beams
            const glm::dvec3 on_wall = glm::dvec3(points[i]) + glm::dvec3(kDriveLength_m, 0.0, 0.0);
            double least = kPi;
            for (const Beam& beam : beams)
                least = std::min(least, measure_distance_to_beam(beam, on_wall, kDriveLength_m));
            worst = std::max(worst, least);
        }
        EXPECT_LT(worst, 1e-4) << "beams are 2e-3 apart";
    }
}

TEST_F(Sensorsim, ObjectsMoveFromTheirFirstPoseToTheirLast) {
    start_sensorsim();
    const Pose still{};
    wire::LidarRenderRequest request = moving();
    set_pair(*request.mutable_sensor_pose(), still, still);
    add_car(request, {{1, 0, 0, 0}, {3.0, 0.0, 0.0}}, {{1, 0, 0, 0}, {7.0, 0.0, 0.0}});
    const std::vector<glm::vec3> points = values<glm::vec3>(render(request).xyz_buffer());
    std::vector<glm::vec3> plate;
    for (const glm::vec3& point : points)
        if (point.x < 9.0f) plate.push_back(point);
    ASSERT_GT(plate.size(), 100u);
    // A ray to azimuth a is fired when (pi - a) / (2 pi) of the frame has passed.
    for (const glm::vec3& point : plate) {
        const double azimuth = std::atan2(double(point.y), double(point.x));
        const double share = (kPi - azimuth) / (2.0 * kPi);
        EXPECT_NEAR(point.x, 3.0 + 4.0 * share, 0.1) << "beams are up to 7.8 degrees off the head";
    }
}

TEST_F(Sensorsim, TranslationFirstIsASwitch) {
    start_sensorsim(PoseTransformOrder::translation_first);
    const auto other = [](const Pose& pose) {
        return Pose{pose.rotation, glm::inverse(pose.rotation) * pose.translation};
    };
    wire::LidarRenderRequest request = moving();
    set_pair(*request.mutable_sensor_pose(), other(kStart), other(kEnd));
    const wire::LidarRenderReturn scan = render(request);
    ASSERT_GT(scan.count(), 1000u);
    EXPECT_THAT(world_x(scan, kEnd), testing::Each(LiesAt(10.0)));
}

TEST_F(Sensorsim, AggregatesLidarScansAlone) {
    start_sensorsim();
    wire::AggregatedRenderRequest request;
    *request.add_lidar() = moving();
    *request.add_lidar() = moving();
    request.mutable_lidar(1)->mutable_lidar()->set_lidar_type(wire::AT128);
    const auto [status, answer] = call(*calls, &Stub::render_aggregated, request);
    ASSERT_TRUE(status.ok());
    ASSERT_EQ(answer.lidar_size(), 2);
    EXPECT_EQ(answer.lidar(0).SerializeAsString(), render(request.lidar(0)).SerializeAsString());
    EXPECT_EQ(answer.lidar(1).SerializeAsString(), render(request.lidar(1)).SerializeAsString());
    EXPECT_NE(answer.lidar(0).count(), answer.lidar(1).count());
    const auto refused = [&] { return call(*calls, &Stub::render_aggregated, request).status; };
    for (int i = 2; i < 65; ++i) request.add_lidar();
    EXPECT_EQ(refused().error_code(), Code::INVALID_ARGUMENT);
    EXPECT_THAT(refused().error_message(), Names("lidar ... 65 ... 64"));
    request.add_rgb();
    EXPECT_EQ(refused().error_code(), Code::UNIMPLEMENTED);
    EXPECT_THAT(refused().error_message(), Names("1 images ... LiDAR"));
}

TEST_F(Sensorsim, IsOfferedWhereItIsWantedAlone) {
    start();
    calls = wire::SensorsimService::NewStub(open_channel(address()));
    EXPECT_EQ(refused(moving()).error_code(), Code::UNIMPLEMENTED);
}

TEST_F(Sensorsim, SaysWhatMakesNoSense) {
    start_sensorsim();
    const std::string pose = "{ translation { } rotation { w: 1 } }", start = "sensor_pose { start " + pose,
                      still = "pose { start " + pose + " end " + pose + " }",
                      car = "dynamic_objects { track_id: 'car' " + still + " }";
    struct SensorsimCase {
        std::string fields;  ///< added to a valid request; a pose replaces the valid pose
        const char* says;
        Code code = Code::INVALID_ARGUMENT;
    };
    const std::vector<SensorsimCase> cases = {
        {"scene_id: 'smal'", "scene_id ... \"smal\" ... \"small\"", Code::NOT_FOUND},
        {"sensor_pose { end { } }", "sensor_pose ... start"},
        {"sensor_pose { start { } }", "end"},
        {start + "end { translation { } } }", "sensor_pose.end ... rotation"},
        {start + "end { translation { } rotation { } } }", "sensor_pose.end.rotation ... 0"},
        {"sensor_pose { start { translation { z: nan } rotation { w: 1 } } end { } }",
         "sensor_pose.start.translation.z ... nan"},
        {"frame_end_us: 399999", "frame_end_us ... 399999 ... frame_start_us 400000"},
        {"frame_end_us: 100400000", "frame_end_us"},
        {"frame_end_us: 400000", "sensor_pose ... duration"},
        {"lidar { lidar_type: 7 }", "lidar.lidar_type ... 7 ... (PANDAR128), 1 (AT128) ... 2 (OTHER)"},
        {"lidar { logical_id: 'roof' }", "lidar.logical_id ... \"roof\"", Code::NOT_FOUND},
        {"dynamic_objects { track_id: 'cat' " + still + " }",
         "dynamic_objects[0].track_id ... \"cat\" ... \"car\"", Code::NOT_FOUND},
        {"dynamic_objects { track_id: 'car' }", "dynamic_objects[0].pose ... start"},
        {car + car, "dynamic_objects[1].track_id ... \"car\""},
    };
    for (const SensorsimCase& wrong : cases) {
        wire::LidarRenderRequest request = moving();
        if (wrong.fields.starts_with("sensor_pose")) request.clear_sensor_pose();
        const grpc::Status status = refused(merge(request, wrong.fields));
        EXPECT_EQ(status.error_code(), wrong.code) << wrong.says;
        EXPECT_THAT(status.error_message(), Names(wrong.says));
    }
    EXPECT_GT(render(moving()).count(), 1000u) << "and the next one is answered";
    wire::LidarRenderRequest moment = moving();
    moment.set_frame_end_us(400'000);
    set_pair(*moment.mutable_sensor_pose(), kEnd, kEnd);
    EXPECT_THAT(world_x(render(moment), kEnd), testing::Each(LiesAt(10.0)))
        << "a sensor that stands may take no time";
}

TEST_F(Sensorsim, AnswersUnderTheNameOfNuRec2610) {
    start_sensorsim();
    const auto channel = open_channel(address());
    const auto call_renamed = [&](const char* method, const auto& request, auto answer) {
        const std::string name = std::string("/nurec.grpc.protos.sensorsim.SensorsimService/") + method;
        const grpc::internal::RpcMethod rpc(name.c_str(), grpc::internal::RpcMethod::NORMAL_RPC);
        grpc::ClientContext context;
        EXPECT_TRUE(grpc::internal::BlockingUnaryCall(channel.get(), rpc, &context, request, &answer).ok());
        return answer;
    };
    EXPECT_EQ(call_renamed("render_lidar", moving(), wire::LidarRenderReturn()).SerializeAsString(),
              render(moving()).SerializeAsString());
    EXPECT_THAT(call_renamed("get_loaded_scenes", wire::Empty(), wire::LoadedScenes()),
                IsMessage(R"(loaded_instance_capacity: 1
        scenes { scene_id: "small" loaded_instance_count: 1 reusable_instance_count: 1 })"))
        << "a scan of the only scene was rendered";
}

TEST_F(Sensorsim, LogicalIdTellsTheLidarsOfTheLogApart) {
    relidar::Run run = make_small_run(folder / "small");
    run.log.lidars.push_back(run.log.lidars[0]);
    run.log.lidars[0].name = "front";
    run.log.lidars[1].name = "rear";
    run.log.lidars[1].sensor.beams = {{0.05}, {-0.05}};
    save_run(run);
    start_sensorsim();
    wire::LidarRenderRequest request = moving();
    set_pair(*request.mutable_sensor_pose(), {}, {});
    request.mutable_lidar()->set_lidar_type(wire::OTHER);
    const auto estimate_elevations = [&](const char* logical_id) {
        request.mutable_lidar()->set_logical_id(logical_id);
        std::set<double> elevations;
        for (const glm::vec3& point : values<glm::vec3>(render(request).xyz_buffer()))
            elevations.insert(std::round(1e4 * std::atan2(point.z, std::hypot(point.x, point.y))) / 1e4);
        return elevations;
    };
    EXPECT_THAT(estimate_elevations("front"), testing::ElementsAre(-0.1, 0.0, 0.1));
    EXPECT_THAT(estimate_elevations("rear"), testing::ElementsAre(-0.05, 0.05));
    request.mutable_lidar()->clear_logical_id();
    EXPECT_THAT(refused(request).error_message(), Names("lidar.logical_id ... OTHER ... 2 LiDARs"));
}

TEST_F(Sensorsim, ListsTheActorsOfTheLog) {
    start_sensorsim();
    EXPECT_THAT(call(*calls, &Stub::get_dynamic_objects, {}).answer, IsMessage(R"(dynamic_objects {
        id: "car" semantic_class: "Car" object_size { x: 1 y: 1 z: 1 } trajectory {
            poses { pose { translation { x: 4 } rotation { w: 1 } } }
            poses { pose { translation { x: 4 } rotation { w: 1 } } timestamp_us: 1000000 } } })"));
}

/// The vehicle and its LiDAR have the same trajectory in relidar's world, near the log.
TEST_F(Sensorsim, TellsTheWaysOfTheLog) {
    start_sensorsim();
    const auto which = parse<wire::SceneRequest>("scene_id: 'small'");
    const std::string trajectory = R"(trajectories { trajectory {
        poses { pose { translation { } rotation { w: 1 } } }
        poses { pose { translation { } rotation { w: 1 } } timestamp_us: 500000 }
        poses { pose { translation { } rotation { w: 1 } } timestamp_us: 1000000 } } })";
    EXPECT_THAT(call(*calls, &Stub::get_available_trajectories, which).answer,
                IsMessage(trajectory + trajectory));
}

}  // namespace
}  // namespace relidar::serve
