// SPDX-License-Identifier: Apache-2.0
// Starts a service in the test process with a small run that renders in milliseconds. The
// run has a wall 10 m ahead of the log's sensor, and an actor "car", which is a plate 4 m
// ahead.
#pragma once

#include <cmath>
#include <cstring>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <google/protobuf/text_format.h>
#include <google/protobuf/util/message_differencer.h>

#include <relidar/run/run.hpp>

#include "../base/codecs/temporary_folder.hpp"
#include "../support/device.hpp"
#include "client.hpp"
#include "geometry_messages.hpp"
#include "server.hpp"

namespace relidar::serve {

/// Adds the fields of a text in Protobuf's text format to a message.
template <class Message>
Message& merge(Message& message, const std::string& text) {
    EXPECT_TRUE(google::protobuf::TextFormat::MergeFromString(text, &message)) << text;
    return message;
}

template <class Message>
Message parse(const std::string& text) {
    Message message;
    return merge(message, text);
}

MATCHER_P(IsMessage, text, text) {
    return google::protobuf::util::MessageDifferencer::Equals(arg,
                                                              parse<std::remove_cvref_t<arg_type>>(text));
}

inline const glm::dvec3 kDatasetOrigin_m(455000.0, 5428000.0, 113.0);

inline Pose make_pose_at_x(double x_m) {
    return {{1, 0, 0, 0}, kDatasetOrigin_m + glm::dvec3(x_m, 0.0, 0.0)};
}

inline Run make_small_run(const std::filesystem::path& folder) {
    Run run;
    run.folder = folder;
    Surfels& surfels = run.scene.surfels;
    surfels.resize(2);
    surfels.mean = {{10.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}};
    surfels.rotation.assign(2, {std::sqrt(0.5f), 0.0f, std::sqrt(0.5f), 0.0f});  // normals along x
    surfels.log_scale = {glm::vec2(std::log(5.0f)), glm::vec2(std::log(0.5f))};
    surfels.opacity_logit.assign(2, 6.0f);
    surfels.sh.assign(2 * kShFloats, 0.0f);
    for (std::size_t i = 0; i < 2; ++i) surfels.sh[i * kShFloats + kShCoefficients] = 20.0f;  // hit logit
    run.scene.models = {{"background", 0, 1}, {"car", 1, 1}};
    run.scene.instances = {{0, ""}, {1, "car"}};
    Log& log = run.log;
    log.lidars[0].sensor = {"small", {{0.1}, {0.0}, {-0.1}}, 64};
    log.lidars[0].sensor.first_azimuth_rad = kPi - kPi / 64;
    const Pose car{{1, 0, 0, 0}, {4, 0, 0}};
    for (int i = 0; i < 3; ++i) {
        log.frames.push_back({i, 0.5 * i, {}});
        log.world_from_vehicle.time_s.push_back(0.5 * i);
        log.world_from_vehicle.pose.push_back({});
    }
    log.world_offset_m = kDatasetOrigin_m;
    log.boxes = {{"car", "Car", {1, 1, 1}, {{0.0, 1.0}, {car, car}}}};
    run.split = {{0, 1, 2}, {}};
    // rays over a quarter turn ahead, to the wall and past its edges
    for (double y_m = -20.0; y_m <= 20.0; y_m += 0.5)
        for (double z_m = -2.0; z_m <= 2.0; z_m += 0.5)
            run.coverage.add_segment(glm::dvec3(0.0), glm::dvec3(20.0, y_m, z_m));
    return run;
}

class ServiceTest : public test::DeviceTest {
protected:
    using Stub = v1::RenderService::Stub;
    const ScratchFolder scratch;
    const std::filesystem::path folder = scratch.path;  ///< folder of the runs
    std::vector<std::string> assets;                    ///< folders of the assets
    std::optional<std::string> channels;                ///< channels of all scans
    Weather weather;                                    ///< weather of scans whose request has no weather
    std::optional<PoseTransformOrder> sensorsim;
    std::optional<ScanServer> server;
    std::unique_ptr<Stub> calls;  ///< a connection to the server

    void TearDown() override {
        server.reset();
        DeviceTest::TearDown();
    }

    void start(std::size_t waiting = 64, const std::vector<std::string>& names = {"small"},
               std::uint64_t memory_mib = 0) {
        ServerOptions options;
        options.assets = assets;
        options.channels = channels;
        options.weather = weather;
        options.sensorsim = sensorsim;
        for (const std::string& name : names) {
            if (!std::filesystem::exists(folder / name)) save_run(make_small_run(folder / name));
            options.runs.push_back((folder / name).string());
        }
        options.listen = "127.0.0.1:0";
        options.waiting = waiting;
        options.memory_mib = memory_mib;
        options.device = apply_environment({.traversal = device().backend()});
        server.emplace(options);
        calls = stub();
    }
    std::string address() const { return "127.0.0.1:" + std::to_string(server->port()); }
    std::unique_ptr<Stub> stub() const { return v1::RenderService::NewStub(open_channel(address())); }
    v1::LidarScan scan_of(const v1::RenderLidarRequest& request) const {
        const auto [status, scan] = call(*calls, &Stub::RenderLidar, request);
        EXPECT_TRUE(status.ok()) << status.error_message();
        return scan;
    }
};

inline void add_pose(google::protobuf::RepeatedPtrField<v1::TimedPose>& poses, double time_s,
                     const Pose& pose) {
    v1::TimedPose& added = *poses.Add();
    added.set_time_s(time_s);
    write_pose(pose, *added.mutable_pose());
}

inline void set_path(v1::RenderLidarRequest& request, const PoseTrack& path) {
    request.clear_path();
    for (std::size_t i = 0; i < path.pose.size(); ++i)
        add_pose(*request.mutable_path(), path.time_s[i], path.pose[i]);
}

inline v1::RenderLidarRequest make_standing_request() {
    auto request =
        parse<v1::RenderLidarRequest>("wanted { points: true range_image: true drop_probability: true }");
    add_pose(*request.mutable_path(), 0.5, make_pose_at_x(0.0));
    return request;
}

/// Returns a sensor with `count` rays that point straight ahead. With a large `count`,
/// rendering the sensor is slow.
inline v1::SensorSpec make_rays_ahead(std::size_t count) {
    v1::SensorSpec spec;
    const glm::vec3 ahead(1.0f, 0.0f, 0.0f);
    std::string& direction = *spec.mutable_rays()->mutable_direction();
    for (std::size_t i = 0; i < count; ++i)
        direction.append(reinterpret_cast<const char*>(&ahead), sizeof(ahead));
    return spec;
}

template <class T>
std::vector<T> values(const std::string& bytes) {
    std::vector<T> result(bytes.size() / sizeof(T));
    std::memcpy(result.data(), bytes.data(), bytes.size());
    return result;
}

}  // namespace relidar::serve
