// SPDX-License-Identifier: Apache-2.0
// Invalid requests get a one-line status, and the next request is answered.

#include <fmt/format.h>

#include "small_service.hpp"
#include "support/names.hpp"

namespace relidar::serve {
namespace {

using test::Names;
using Code = grpc::StatusCode;

struct Case {
    std::string fields;  ///< Added to a valid request. A path replaces the path of this request.
    const char* says;
    Code code = Code::INVALID_ARGUMENT;
};

std::string repeat(const std::string& text, std::size_t count) {
    std::string all;
    while (count-- > 0) all += text;
    return all;
}

std::string spec(const std::string& fields) { return "sensor { spec { " + fields + " } }"; }

/// Returns rays that point straight ahead.
std::string rays(std::size_t count, const std::string& fields = "") {
    const std::string one = R"(\000\000\200\077\000\000\000\000\000\000\000\000)";
    return "rays { direction: '" + repeat(one, count) + "' " + fields + " }";
}

const std::vector<Case> kPoseCases = {
    {"path: []", "path ... 0"},
    {"path { pose { translation { y: nan } } }", "path[0].pose.translation.y ... nan"},
    {"path { pose { translation { x: 1e300 } } }", "1e+300"},
    {"path { pose { rotation { w: nan } } }", "path[0].pose.rotation ... nan"},
    {"path { pose { rotation { w: 2 } } }", "quaternion ... 2"},
    {"path { pose { rotation { } } }", "quaternion ... 0"},
    {"path { time_s: nan }", "path[0].time_s ... nan"},
    {"path { time_s: 0.5 } path { time_s: 0.4 }", "path[1].time_s ... 0.4 ... 0.5"},
    {"time_s: nan", "time_s ... nan"},
    {"path { time_s: 0.5 } path { time_s: 0.6 } time_s: 500000", "time_s ... 500000 s ... 0.5 ... 0.6 s"},
    {"path { time_s: 0.5 } path { time_s: 0.6 } time_s: 2.7", "time_s ... 2.7 s ... 0.5 ... 0.6 s"},
    {"path { time_s: 0.5 } path { time_s: 0.6 } points_at_s: -500", "points_at_s"},
    {"scene: 'smal'", "scene ... \"smal\" ... \"small\"", Code::NOT_FOUND},
    {"weather: 'fog=0'", "weather ... fog=0 ... 1 ... 1e6"},
    {"lidar: 'roof'", "lidar ... \"roof\"", Code::NOT_FOUND},
    {"actors { actors { name: 'cat' poses { } } }", "actors.actors[0].name ... \"cat\" ... \"car\"",
     Code::NOT_FOUND},
    {"actors { actors { name: 'car' } }", "actors.actors[0].poses ... 0"},
    {"time_s: 0.5 actors { actors { name: 'car' poses { time_s: 3 } poses { time_s: 4 } } }",
     "actors.actors[0].poses ... 3 ... 4 s ... 0.5 s"},
    {"actors { actors { name: 'car' poses { } } actors { name: 'car' poses { } } }", "actor"},
};

const std::vector<Case> kSensorCases = {
    {"sensor { name: 'VLP-17' }", "\"VLP-17\" ... ListScenes ... VLP-16"},
    {"sensor { name: '/etc/passwd' }", "\"/etc/passwd\""},
    {"sensor { name: 'VLP-16:../../x.csv' }", "ListScenes"},
    {"sensor { name: 'VLP-16:1000000x10' }", "16000000 rays ... 1048576"},
    {"sensor { name: 'VLP-16:0x10' }", "0 columns"},
    {"sensor { name: '" + repeat("x", 100'000) + "' }", "100000 bytes"},
    {"sensor { name: 'a\\nb' }", "\"a b\""},
    {spec(rays(1) + " name: '" + repeat("x", 201) + "'"), "sensor.spec.name"},
    {"sensor { handle: 'sensor-9' }", "upload", Code::NOT_FOUND},
    {spec(""), "rays, spinning, window"},
    {spec("rays { }"), "0 rays"},
    {spec("rays { direction: '1234567' }"), "7 ... 12"},
    {spec(rays(3, "rows: 2 columns: 2")), "2 ... 2 ... 3 directions"},
    {spec(rays(3, "time_s: '12345678'")), "rays.time_s ... 8 ... 12"},
    {spec("rays { direction: '" + repeat("\\000", 12) + "' }"), "ray 0 ... 0 ... 1"},
    {spec("rays { direction: '" + repeat("\\377", 12) + "' }"), "nan"},
    {spec(rays(1, "origin_m: '" + repeat("\\377", 12) + "'")), "origin_m ... ray 0"},
    {spec(rays(1, "divergence_rad: '" + repeat("\\377", 4) + "'")), "rays.divergence_rad ... ray 0"},
};

const std::vector<Case> kPatternCases = {
    {spec("spinning { beams { } }"), "0 rays"},
    {spec("spinning { columns: 8 period_s: 0.1 beams { elevation_rad: nan } }"),
     "beams[0].elevation_rad ... nan"},
    {spec("spinning { columns: 8 period_s: 0.1 beams { elevation_rad: -15 } }"),
     "beams[0].elevation_rad ... -15 ... -1.57"},
    {spec("spinning { columns: 8 period_s: 0.1 beams { elevation_rad: -0.1 } beams { elevation_rad: 0.1 } }"),
     "-0.1 rad ... 0.1 rad"},
    {spec("spinning { columns: 8 beams { } }"), "spinning.period_s ... 0"},
    {spec("window { rows: 2 columns: 2 top_rad: -0.1 bottom_rad: 0.1 period_s: 0.1 }"),
     "window.bottom_rad ... 0.1"},
    {spec("window { rows: 4294967295 columns: 4294967295 }"), "rays ... 1"},
    {spec("rosette { rays: 10 period_s: 0.1 first_hz: nan }"), "rosette.first_hz ... nan"},
    {spec(rays(1) + " max_range_m: -1"), "max_range_m"},
    {"returns: 3", "3 ... 0, 1 ... 2"},
    {spec(rays(1)) + " returns: 2", "divergence"},
};

class Refusals : public ServiceTest {
protected:
    void expect_refused(const std::vector<Case>& cases) {
        start();
        const v1::LidarScan before = scan_of(make_standing_request());
        for (const Case& wrong : cases) {
            SCOPED_TRACE(wrong.says);
            v1::RenderLidarRequest request = make_standing_request();
            if (wrong.fields.starts_with("path")) request.clear_path();
            const grpc::Status status = call(*calls, &Stub::RenderLidar, merge(request, wrong.fields)).status;
            EXPECT_EQ(status.error_code(), wrong.code);
            EXPECT_THAT(status.error_message(), Names(wrong.says));
            EXPECT_EQ(status.error_message().find('\n'), std::string::npos);
            ASSERT_EQ(scan_of(make_standing_request()).image().range_m(), before.image().range_m())
                << "nothing is left behind";
        }
    }
    Reply<v1::UploadSensorResponse> upload(std::size_t n_rays) {
        v1::UploadSensorRequest request;
        *request.mutable_sensor() = make_rays_ahead(n_rays);
        return call(*calls, &Stub::UploadSensor, request);
    }
    grpc::Status render_rig(const v1::RenderRigRequest& request) {
        grpc::ClientContext context;
        const auto reader = calls->RenderRig(&context, request);
        v1::RigScan scan;
        EXPECT_FALSE(reader->Read(&scan));
        return reader->Finish();
    }
};

TEST_F(Refusals, PosesTimesAndNames) { expect_refused(kPoseCases); }
TEST_F(Refusals, Sensors) { expect_refused(kSensorCases); }
TEST_F(Refusals, PatternsOfSensors) { expect_refused(kPatternCases); }

TEST_F(Refusals, TablesBeyondTheLimits) {
    start();
    constexpr std::size_t kMost = std::size_t(1) << 20;
    EXPECT_TRUE(upload(kMost).status.ok());
    const grpc::Status one_more = upload(kMost + 1).status, message_too_large = upload(4 * kMost).status;
    EXPECT_EQ(one_more.error_code(), Code::INVALID_ARGUMENT);
    EXPECT_THAT(one_more.error_message(), Names("1048577 rays ... 1048576"));
    EXPECT_EQ(message_too_large.error_code(), Code::RESOURCE_EXHAUSTED) << "gRPC's own limit";
    EXPECT_TRUE(upload(1).status.ok());
}

TEST_F(Refusals, UploadedSensorsAreForgottenOldestFirst) {
    start();
    std::vector<std::string> handles;
    for (int i = 0; i < 65; ++i) {
        const auto [status, answer] = upload(1);
        ASSERT_TRUE(status.ok());
        EXPECT_EQ(answer.kept(), 64u);
        handles.push_back(answer.handle());
    }
    const auto code = [&](const std::string& handle) {
        v1::RenderLidarRequest request = make_standing_request();
        request.mutable_sensor()->set_handle(handle);
        return call(*calls, &Stub::RenderLidar, request).status.error_code();
    };
    EXPECT_EQ(code(handles.front()), Code::NOT_FOUND);
    EXPECT_EQ(code(handles[1]), Code::OK);
    EXPECT_EQ(code(handles.back()), Code::OK);
}

TEST_F(Refusals, RigsAreLookedAtBeforeAnythingIsRendered) {
    start();
    const std::string good = "rig_from_sensor { rotation { w: 1 } } sensor { name: 'VLP-16' }";
    const std::vector<std::pair<std::string, const char*>> cases = {
        {"", "rig ... 0 ... 1"},
        {"sensors { name: 'good' } sensors { sensor { name: 'no such' } }", "\"no such\""},
        {"sensors { name: 'good' " + good + " } sensors { name: 'good' " + good + " }",
         "sensors[1].name ... \"good\""},
        {"sensors { " + good + " } sensors { " + good + " }", "sensors[1].name ... \"\""}};
    for (const auto& [sensors, says] : cases) {
        auto request = parse<v1::RenderRigRequest>(sensors);
        *request.mutable_rig() = make_standing_request();
        const grpc::Status status = render_rig(request);
        EXPECT_EQ(status.error_code(), Code::INVALID_ARGUMENT) << says;
        EXPECT_THAT(status.error_message(), Names(says));
    }
}

}  // namespace
}  // namespace relidar::serve
