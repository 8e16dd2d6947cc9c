// SPDX-License-Identifier: Apache-2.0
// Invalid requests get a one-line status, and the next request is answered.

#include <fmt/format.h>
#include <gmock/gmock.h>

#include "small_service.hpp"
#include "support/names.hpp"

namespace relidar::serve {
namespace {

using test::Names;
using Code = grpc::StatusCode;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

struct Case {
    std::function<void(v1::RenderLidarRequest&)> spoil;
    const char* says;
    Code code = Code::INVALID_ARGUMENT;
};

v1::SensorSpec& spec(v1::RenderLidarRequest& request) { return *request.mutable_sensor()->mutable_spec(); }
v1::Pose& pose(v1::RenderLidarRequest& request) { return *request.mutable_path(0)->mutable_pose(); }
v1::ActorTrack& actor(v1::RenderLidarRequest& request, const std::string& name) {
    v1::ActorTrack& added = *request.mutable_actors()->add_actors();
    added.set_name(name);
    return added;
}

v1::RenderLidarRequest& extend_path(v1::RenderLidarRequest& request) {
    add_pose(*request.mutable_path(), 0.6, make_pose_at_x(0));
    return request;
}

v1::SensorSpec& set_rays(v1::RenderLidarRequest& request, std::size_t count) {
    return spec(request) = make_rays_ahead(count);
}

v1::SpinningSensor& set_spinning(v1::RenderLidarRequest& request, double period_s = 0.1) {
    v1::SpinningSensor& spinning = *spec(request).mutable_spinning();
    spinning.set_columns(8);
    spinning.set_period_s(period_s);
    return spinning;
}

const std::vector<Case> kPoseCases = {
    {[](auto& r) { r.clear_path(); }, "path ... 0"},
    {[](auto& r) { pose(r).mutable_translation()->set_y(kNan); }, "path[0].pose.translation.y ... nan"},
    {[](auto& r) { pose(r).mutable_translation()->set_x(1e300); }, "1e+300"},
    {[](auto& r) { pose(r).mutable_rotation()->set_w(kNan); }, "path[0].pose.rotation ... nan"},
    {[](auto& r) { pose(r).mutable_rotation()->set_w(2.0); }, "quaternion ... 2"},
    {[](auto& r) { pose(r).mutable_rotation()->Clear(); }, "quaternion ... 0"},
    {[](auto& r) { r.mutable_path(0)->set_time_s(kNan); }, "path[0].time_s ... nan"},
    {[](auto& r) { add_pose(*r.mutable_path(), 0.4, make_pose_at_x(0)); }, "path[1].time_s ... 0.4 ... 0.5"},
    {[](auto& r) { r.set_time_s(kNan); }, "time_s ... nan"},
    {[](auto& r) { extend_path(r).set_time_s(500000.0); }, "time_s ... 500000 s ... 0.5 ... 0.6 s"},
    {[](auto& r) { extend_path(r).set_time_s(2.7); }, "time_s ... 2.7 s ... 0.5 ... 0.6 s"},
    {[](auto& r) { extend_path(r).set_points_at_s(-500.0); }, "points_at_s"},
    {[](auto& r) { r.set_scene("smal"); }, "scene ... \"smal\" ... \"small\"", Code::NOT_FOUND},
    {[](auto& r) { r.set_weather("fog=0"); }, "weather ... fog=0 ... 1 ... 1e6"},
    {[](auto& r) { r.set_lidar("roof"); }, "lidar ... \"roof\"", Code::NOT_FOUND},
    {[](auto& r) { add_pose(*actor(r, "cat").mutable_poses(), 0, make_pose_at_x(0)); },
     "actors.actors[0].name ... \"cat\" ... \"car\"", Code::NOT_FOUND},
    {[](auto& r) { actor(r, "car"); }, "actors.actors[0].poses ... 0"},
    {[](auto& r) {
         r.set_time_s(0.5);
         v1::ActorTrack& car = actor(r, "car");
         add_pose(*car.mutable_poses(), 3.0, make_pose_at_x(4));
         add_pose(*car.mutable_poses(), 4.0, make_pose_at_x(5));
     },
     "actors.actors[0].poses ... 3 ... 4 s ... 0.5 s"},
    {[](auto& r) {
         for (int i = 0; i < 2; ++i) add_pose(*actor(r, "car").mutable_poses(), 0, make_pose_at_x(0));
     },
     "actor"},
};

const std::vector<Case> kSensorCases = {
    {[](auto& r) { r.mutable_sensor()->set_name("VLP-17"); }, "\"VLP-17\" ... ListScenes ... VLP-16"},
    {[](auto& r) { r.mutable_sensor()->set_name("/etc/passwd"); }, "\"/etc/passwd\""},
    {[](auto& r) { r.mutable_sensor()->set_name("VLP-16:../../x.csv"); }, "ListScenes"},
    {[](auto& r) { r.mutable_sensor()->set_name("VLP-16:1000000x10"); }, "16000000 rays ... 1048576"},
    {[](auto& r) { r.mutable_sensor()->set_name("VLP-16:0x10"); }, "0 columns"},
    {[](auto& r) { r.mutable_sensor()->set_name(std::string(100000, 'x')); }, "100000 bytes"},
    {[](auto& r) { r.mutable_sensor()->set_name("a\nb"); }, "\"a b\""},
    {[](auto& r) { set_rays(r, 1).set_name(std::string(201, 'x')); }, "sensor.spec.name"},
    {[](auto& r) { r.mutable_sensor()->set_handle("sensor-9"); }, "upload", Code::NOT_FOUND},
    {[](auto& r) { spec(r); }, "rays, spinning, window"},
    {[](auto& r) { spec(r).mutable_rays(); }, "0 rays"},
    {[](auto& r) { spec(r).mutable_rays()->set_direction("1234567"); }, "7 ... 12"},
    {[](auto& r) {
         spec(r) = make_rays_ahead(3);
         spec(r).mutable_rays()->set_rows(2);
         spec(r).mutable_rays()->set_columns(2);
     },
     "2 ... 2 ... 3 directions"},
    {[](auto& r) { set_rays(r, 3).mutable_rays()->set_time_s(std::string(8, '\0')); },
     "rays.time_s ... 8 ... 12"},
    {[](auto& r) { spec(r).mutable_rays()->set_direction(std::string(12, '\0')); }, "ray 0 ... 0 ... 1"},
    {[](auto& r) { spec(r).mutable_rays()->set_direction(std::string(12, '\xff')); }, "nan"},
    {[](auto& r) { set_rays(r, 1).mutable_rays()->set_origin_m(std::string(12, '\xff')); },
     "origin_m ... ray 0"},
    {[](auto& r) { set_rays(r, 1).mutable_rays()->set_divergence_rad(std::string(4, '\xff')); },
     "rays.divergence_rad ... ray 0"},
};

const std::vector<Case> kPatternCases = {
    {[](auto& r) { spec(r).mutable_spinning()->add_beams(); }, "0 rays"},
    {[](auto& r) { set_spinning(r).add_beams()->set_elevation_rad(kNan); }, "beams[0].elevation_rad ... nan"},
    {[](auto& r) { set_spinning(r).add_beams()->set_elevation_rad(-15.0); },
     "beams[0].elevation_rad ... -15 ... -1.57"},
    {[](auto& r) {
         v1::SpinningSensor& s = set_spinning(r);
         s.add_beams()->set_elevation_rad(-0.1);
         s.add_beams()->set_elevation_rad(0.1);
     },
     "-0.1 rad ... 0.1 rad"},
    {[](auto& r) {
         v1::ScanningWindow& w = *spec(r).mutable_window();
         w.set_rows(2);
         w.set_columns(2);
         w.set_top_rad(-0.1);
         w.set_bottom_rad(0.1);
         w.set_period_s(0.1);
     },
     "window.bottom_rad ... 0.1"},
    {[](auto& r) { set_spinning(r, 0.0).add_beams(); }, "spinning.period_s ... 0"},
    {[](auto& r) {
         spec(r).mutable_window()->set_rows(4294967295u);
         spec(r).mutable_window()->set_columns(4294967295u);
     },
     "rays ... 1"},
    {[](auto& r) {
         v1::Rosette& s = *spec(r).mutable_rosette();
         s.set_rays(10);
         s.set_period_s(0.1);
         s.set_first_hz(kNan);
     },
     "rosette.first_hz ... nan"},
    {[](auto& r) { set_rays(r, 1).set_max_range_m(-1.0); }, "max_range_m"},
    {[](auto& r) { r.set_returns(3); }, "3 ... 0, 1 ... 2"},
    {[](auto& r) {
         set_rays(r, 1);
         r.set_returns(2);
     },
     "divergence"},
};

class Refusals : public ServiceTest {
protected:
    void expect_refused(const std::vector<Case>& cases) {
        start();
        const auto calls = stub();
        const v1::LidarScan before = ScanClient(address()).render_scan(make_standing_request());
        for (const Case& c : cases) {
            SCOPED_TRACE(c.says);
            v1::RenderLidarRequest request = make_standing_request();
            c.spoil(request);
            grpc::ClientContext spoilt, good;
            v1::LidarScan answer;
            const grpc::Status status = calls->RenderLidar(&spoilt, request, &answer);
            EXPECT_EQ(status.error_code(), c.code);
            EXPECT_THAT(status.error_message(), Names(c.says));
            EXPECT_EQ(status.error_message().find('\n'), std::string::npos);
            ASSERT_TRUE(calls->RenderLidar(&good, make_standing_request(), &answer).ok());
            EXPECT_EQ(answer.image().range_m(), before.image().range_m()) << "nothing is left behind";
        }
    }
};

TEST_F(Refusals, PosesTimesAndNames) { expect_refused(kPoseCases); }
TEST_F(Refusals, Sensors) { expect_refused(kSensorCases); }
TEST_F(Refusals, PatternsOfSensors) { expect_refused(kPatternCases); }

TEST_F(Refusals, TablesBeyondTheLimits) {
    start();
    const auto calls = stub();
    const auto uploaded = [&](std::size_t rays) {
        grpc::ClientContext context;
        v1::UploadSensorRequest request;
        v1::UploadSensorResponse answer;
        *request.mutable_sensor() = make_rays_ahead(rays);
        return calls->UploadSensor(&context, request, &answer);
    };
    constexpr std::size_t kMost = std::size_t(1) << 20;
    EXPECT_TRUE(uploaded(kMost).ok());
    const grpc::Status one_more = uploaded(kMost + 1), message_too_large = uploaded(4 * kMost);
    EXPECT_EQ(one_more.error_code(), Code::INVALID_ARGUMENT);
    EXPECT_THAT(one_more.error_message(), Names("1048577 rays ... 1048576"));
    EXPECT_EQ(message_too_large.error_code(), Code::RESOURCE_EXHAUSTED) << "gRPC's own limit";
    EXPECT_TRUE(uploaded(1).ok());
}

TEST_F(Refusals, UploadedSensorsAreForgottenOldestFirst) {
    start();
    const auto calls = stub();
    std::vector<std::string> handles;
    for (int i = 0; i < 65; ++i) {
        grpc::ClientContext context;
        v1::UploadSensorRequest request;
        v1::UploadSensorResponse answer;
        *request.mutable_sensor() = make_rays_ahead(1);
        ASSERT_TRUE(calls->UploadSensor(&context, request, &answer).ok());
        EXPECT_EQ(answer.kept(), 64u);
        handles.push_back(answer.handle());
    }
    const auto code = [&](const std::string& handle) {
        grpc::ClientContext context;
        v1::RenderLidarRequest request = make_standing_request();
        request.mutable_sensor()->set_handle(handle);
        v1::LidarScan answer;
        return calls->RenderLidar(&context, request, &answer).error_code();
    };
    EXPECT_EQ(code(handles.front()), Code::NOT_FOUND);
    EXPECT_EQ(code(handles[1]), Code::OK);
    EXPECT_EQ(code(handles.back()), Code::OK);
}

TEST_F(Refusals, RigsAreLookedAtBeforeAnythingIsRendered) {
    start();
    const auto calls = stub();
    const auto status_of = [&](const v1::RenderRigRequest& request) {
        grpc::ClientContext context;
        const auto reader = calls->RenderRig(&context, request);
        v1::RigScan scan;
        EXPECT_FALSE(reader->Read(&scan));
        return reader->Finish();
    };
    v1::RenderRigRequest request;
    *request.mutable_rig() = make_standing_request();
    EXPECT_THAT(status_of(request).error_message(), Names("rig ... 0 ... 1"));
    request.add_sensors()->set_name("good");
    request.add_sensors()->mutable_sensor()->set_name("no such");
    const grpc::Status status = status_of(request);
    EXPECT_EQ(status.error_code(), Code::INVALID_ARGUMENT);
    EXPECT_THAT(status.error_message(), Names("\"no such\""));
    request.mutable_sensors(0)->mutable_sensor()->set_name("VLP-16");
    *request.mutable_sensors(1) = request.sensors(0);
    for (v1::RigSensor& sensor : *request.mutable_sensors())
        sensor.mutable_rig_from_sensor()->mutable_rotation()->set_w(1.0);
    for (const char* name : {"good", ""}) {
        for (v1::RigSensor& sensor : *request.mutable_sensors()) sensor.set_name(name);
        const grpc::Status same_names = status_of(request);
        EXPECT_EQ(same_names.error_code(), Code::INVALID_ARGUMENT) << name;
        EXPECT_THAT(same_names.error_message(), Names(fmt::format("sensors[1].name ... \"{}\"", name)));
    }
}

}  // namespace
}  // namespace relidar::serve
