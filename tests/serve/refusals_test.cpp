// SPDX-License-Identifier: Apache-2.0
// Tests invalid requests. Each request must be rejected with a status whose message is a
// single line, and the server must answer the next request.
#include <functional>
#include <limits>

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
    const char* name;
    std::function<void(v1::RenderLidarRequest&)> spoil;
    Code code;
    const char* says;
};

v1::SensorSpec& spec(v1::RenderLidarRequest& request) { return *request.mutable_sensor()->mutable_spec(); }
v1::Pose& pose(v1::RenderLidarRequest& request) { return *request.mutable_path(0)->mutable_pose(); }
v1::ActorTrack& actor(v1::RenderLidarRequest& request, const std::string& name) {
    v1::ActorTrack& added = *request.mutable_actors()->add_actors();
    added.set_name(name);
    return added;
}

/// Adds a second pose 0.1 s after the first pose.
v1::RenderLidarRequest& extend_path(v1::RenderLidarRequest& request) {
    add_pose(*request.mutable_path(), 0.6, make_pose_at_x(0));
    return request;
}

/// Makes a sensor of one ray, and returns it.
v1::SensorSpec& set_one_ray(v1::RenderLidarRequest& request) {
    spec(request) = make_rays_ahead(1);
    return spec(request);
}

/// Makes a spinning sensor without beams, and returns it.
v1::SpinningSensor& set_spinning(v1::RenderLidarRequest& request) {
    v1::SpinningSensor& spinning = *spec(request).mutable_spinning();
    spinning.set_columns(8);
    spinning.set_period_s(0.1);
    return spinning;
}

const std::vector<Case>& cases_of_poses() {
    static const std::vector<Case> all = {
        {"no path", [](auto& r) { r.clear_path(); }, Code::INVALID_ARGUMENT, "path ... 0 poses"},
        {"NaN pose", [](auto& r) { pose(r).mutable_translation()->set_y(kNan); }, Code::INVALID_ARGUMENT,
         "path[0].pose.translation.y ... nan"},
        {"infinite pose", [](auto& r) { pose(r).mutable_translation()->set_x(1e300); },
         Code::INVALID_ARGUMENT, "found 1e+300"},
        {"NaN rotation", [](auto& r) { pose(r).mutable_rotation()->set_w(kNan); }, Code::INVALID_ARGUMENT,
         "path[0].pose.rotation ... nan"},
        {"quaternion of length 2", [](auto& r) { pose(r).mutable_rotation()->set_w(2.0); },
         Code::INVALID_ARGUMENT, "quaternion ... 2"},
        {"empty quaternion", [](auto& r) { pose(r).mutable_rotation()->Clear(); }, Code::INVALID_ARGUMENT,
         "quaternion ... 0"},
        {"NaN time of a pose", [](auto& r) { r.mutable_path(0)->set_time_s(kNan); }, Code::INVALID_ARGUMENT,
         "path[0].time_s: found nan"},
        {"times that fall", [](auto& r) { add_pose(*r.mutable_path(), 0.4, make_pose_at_x(0)); },
         Code::INVALID_ARGUMENT, "path[1].time_s ... 0.4 ... 0.5"},
        {"NaN time", [](auto& r) { r.set_time_s(kNan); }, Code::INVALID_ARGUMENT, "time_s ... nan"},
        {"microseconds", [](auto& r) { extend_path(r).set_time_s(500000.0); }, Code::INVALID_ARGUMENT,
         "time_s ... 500000 s ... 0.5 to 0.6 s"},
        {"two seconds behind the path", [](auto& r) { extend_path(r).set_time_s(2.7); },
         Code::INVALID_ARGUMENT, "time_s ... 2.7 s ... 0.5 to 0.6 s"},
        {"points elsewhen", [](auto& r) { extend_path(r).set_points_at_s(-500.0); }, Code::INVALID_ARGUMENT,
         "points_at_s"},
        {"unknown scene", [](auto& r) { r.set_scene("smal"); }, Code::NOT_FOUND,
         "scene ... \"smal\" ... \"small\""},
        {"no weather", [](auto& r) { r.set_weather("fog=0"); }, Code::INVALID_ARGUMENT,
         "weather ... fog=0 ... 1 to 1e6 metres"},
        {"unknown lidar", [](auto& r) { r.set_lidar("roof"); }, Code::NOT_FOUND, "lidar ... \"roof\""},
        {"unknown actor", [](auto& r) { add_pose(*actor(r, "cat").mutable_poses(), 0, make_pose_at_x(0)); },
         Code::NOT_FOUND, "actors.actors[0].name ... \"cat\" ... \"car\""},
        {"actor without a pose", [](auto& r) { actor(r, "car"); }, Code::INVALID_ARGUMENT,
         "actors.actors[0].poses: found 0 poses"},
        {"actor of another time",
         [](auto& r) {
             r.set_time_s(0.5);
             v1::ActorTrack& car = actor(r, "car");
             add_pose(*car.mutable_poses(), 3.0, make_pose_at_x(4));
             add_pose(*car.mutable_poses(), 4.0, make_pose_at_x(5));
         },
         Code::INVALID_ARGUMENT, "actors.actors[0].poses ... 3 to 4 s ... 0.5 s"},
        {"actor twice",
         [](auto& r) {
             for (int i = 0; i < 2; ++i) add_pose(*actor(r, "car").mutable_poses(), 0, make_pose_at_x(0));
         },
         Code::INVALID_ARGUMENT, "each actor"},
    };
    return all;
}

const std::vector<Case>& cases_of_sensors() {
    static const std::vector<Case> all = {
        {"unknown sensor", [](auto& r) { r.mutable_sensor()->set_name("VLP-17"); }, Code::INVALID_ARGUMENT,
         "\"VLP-17\" ... ListScenes ... VLP-16"},
        {"a file of the server", [](auto& r) { r.mutable_sensor()->set_name("/etc/passwd"); },
         Code::INVALID_ARGUMENT, "\"/etc/passwd\""},
        {"a file behind a name", [](auto& r) { r.mutable_sensor()->set_name("VLP-16:../../x.csv"); },
         Code::INVALID_ARGUMENT, "ListScenes"},
        {"endless columns", [](auto& r) { r.mutable_sensor()->set_name("VLP-16:1000000x10"); },
         Code::INVALID_ARGUMENT, "16000000 rays ... 1 to 1048576"},
        {"no columns", [](auto& r) { r.mutable_sensor()->set_name("VLP-16:0x10"); }, Code::INVALID_ARGUMENT,
         "0 columns"},
        {"a very long name", [](auto& r) { r.mutable_sensor()->set_name(std::string(100000, 'x')); },
         Code::INVALID_ARGUMENT, "of 100000 bytes"},
        {"a name of two lines", [](auto& r) { r.mutable_sensor()->set_name("a\nb"); }, Code::INVALID_ARGUMENT,
         "\"a b\""},
        {"a long name of a spec", [](auto& r) { set_one_ray(r).set_name(std::string(201, 'x')); },
         Code::INVALID_ARGUMENT, "sensor.spec.name"},
        {"forgotten handle", [](auto& r) { r.mutable_sensor()->set_handle("sensor-9"); }, Code::NOT_FOUND,
         "upload"},
        {"empty spec", [](auto& r) { spec(r); }, Code::INVALID_ARGUMENT,
         "pattern ... rays, spinning, window"},
        {"no rays", [](auto& r) { spec(r).mutable_rays(); }, Code::INVALID_ARGUMENT, "0 rays"},
        {"half a ray", [](auto& r) { spec(r).mutable_rays()->set_direction("1234567"); },
         Code::INVALID_ARGUMENT, "7 bytes ... multiple ... 12"},
        {"wrong rows",
         [](auto& r) {
             spec(r) = make_rays_ahead(3);
             spec(r).mutable_rays()->set_rows(2);
             spec(r).mutable_rays()->set_columns(2);
         },
         Code::INVALID_ARGUMENT, "found 2 rows, 2 columns and 3 directions"},
        {"times for some rays",
         [](auto& r) {
             spec(r) = make_rays_ahead(3);
             spec(r).mutable_rays()->set_time_s(std::string(8, '\0'));
         },
         Code::INVALID_ARGUMENT, "rays.time_s: found 8 bytes, expected 12 bytes"},
        {"directions of no length",
         [](auto& r) { spec(r).mutable_rays()->set_direction(std::string(12, '\0')); },
         Code::INVALID_ARGUMENT, "ray 0 ... 0 ... 1"},
        {"NaN direction", [](auto& r) { spec(r).mutable_rays()->set_direction(std::string(12, '\xff')); },
         Code::INVALID_ARGUMENT, "nan"},
        {"NaN origin", [](auto& r) { set_one_ray(r).mutable_rays()->set_origin_m(std::string(12, '\xff')); },
         Code::INVALID_ARGUMENT, "origin_m of ray 0"},
        {"NaN divergence",
         [](auto& r) { set_one_ray(r).mutable_rays()->set_divergence_rad(std::string(4, '\xff')); },
         Code::INVALID_ARGUMENT, "rays.divergence_rad of ray 0"},
    };
    return all;
}

const std::vector<Case>& cases_of_patterns() {
    static const std::vector<Case> all = {
        {"beams without columns", [](auto& r) { spec(r).mutable_spinning()->add_beams(); },
         Code::INVALID_ARGUMENT, "0 rays"},
        {"NaN beam", [](auto& r) { set_spinning(r).add_beams()->set_elevation_rad(kNan); },
         Code::INVALID_ARGUMENT, "beams[0].elevation_rad: found nan"},
        {"degrees as radians", [](auto& r) { set_spinning(r).add_beams()->set_elevation_rad(-15.0); },
         Code::INVALID_ARGUMENT, "beams[0].elevation_rad ... -15 ... -1.57"},
        {"beams from the lowest",
         [](auto& r) {
             v1::SpinningSensor& s = set_spinning(r);
             s.add_beams()->set_elevation_rad(-0.1);
             s.add_beams()->set_elevation_rad(0.1);
         },
         Code::INVALID_ARGUMENT, "-0.1 rad ... 0.1 rad"},
        {"a window upside down",
         [](auto& r) {
             v1::ScanningWindow& w = *spec(r).mutable_window();
             w.set_rows(2);
             w.set_columns(2);
             w.set_top_rad(-0.1);
             w.set_bottom_rad(0.1);
             w.set_period_s(0.1);
         },
         Code::INVALID_ARGUMENT, "window.bottom_rad: found 0.1"},
        {"a turn of no time",
         [](auto& r) {
             spec(r).mutable_spinning()->add_beams();
             spec(r).mutable_spinning()->set_columns(8);
         },
         Code::INVALID_ARGUMENT, "spinning.period_s: found 0"},
        {"a window of 2^64 rays",
         [](auto& r) {
             spec(r).mutable_window()->set_rows(4294967295u);
             spec(r).mutable_window()->set_columns(4294967295u);
         },
         Code::INVALID_ARGUMENT, "rays ... 1 to"},
        {"NaN rosette",
         [](auto& r) {
             v1::Rosette& s = *spec(r).mutable_rosette();
             s.set_rays(10);
             s.set_period_s(0.1);
             s.set_first_hz(kNan);
         },
         Code::INVALID_ARGUMENT, "rosette.first_hz: found nan"},
        {"negative range", [](auto& r) { set_one_ray(r).set_max_range_m(-1.0); }, Code::INVALID_ARGUMENT,
         "max_range_m"},
        {"three returns", [](auto& r) { r.set_returns(3); }, Code::INVALID_ARGUMENT,
         "found 3, expected 0, 1 or 2"},
        {"two returns of an ideal ray",
         [](auto& r) {
             spec(r) = make_rays_ahead(1);
             r.set_returns(2);
         },
         Code::INVALID_ARGUMENT, "divergence"},
    };
    return all;
}

class Refusals : public ServiceTest {
protected:
    void expect_refused(const std::vector<Case>& cases);
};

void Refusals::expect_refused(const std::vector<Case>& cases) {
    start();
    const auto calls = stub();
    v1::LidarScan before;
    {
        grpc::ClientContext context;
        ASSERT_TRUE(calls->RenderLidar(&context, make_standing_request(), &before).ok());
    }
    for (const Case& c : cases) {
        SCOPED_TRACE(c.name);
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

TEST_F(Refusals, PosesTimesAndNames) { expect_refused(cases_of_poses()); }
TEST_F(Refusals, Sensors) { expect_refused(cases_of_sensors()); }
TEST_F(Refusals, PatternsOfSensors) { expect_refused(cases_of_patterns()); }

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
    EXPECT_THAT(one_more.error_message(), Names("found 1048577 rays ... 1 to 1048576"));
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
    EXPECT_THAT(status_of(request).error_message(), Names("rig ... 0 sensors, expected 1 to"));
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
        EXPECT_THAT(same_names.error_message(),
                    Names(fmt::format("sensors[1].name ... \"{}\" a second time", name)));
    }
}

}  // namespace
}  // namespace relidar::serve
