// SPDX-License-Identifier: Apache-2.0
// Data from the network, without device or socket (tools/dev/fuzz_view: the sockets).
#include "harness.hpp"

#include <cstdlib>

#include <relidar/base/error.hpp>

#include "../../tools/view/request.hpp"
#include "run/files/example_run.hpp"
#ifdef RELIDAR_FUZZ_VIEW
#include "../../tools/view/access.hpp"
#endif
#ifdef RELIDAR_FUZZ_SERVE
#include "../../tools/serve/answer_messages.hpp"
#include "../../tools/serve/asset_catalogue.hpp"
#include "../../tools/serve/refusal.hpp"
#include "../../tools/serve/sensorsim_messages.hpp"
#endif

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> make_request_seeds(const fs::path&) {
    const std::string edits =
        R"({"copies": [{"of": "7", "from": "", "at": [1, 2, 0, 90, 5, 0, 0]}], "moves": {"8": [1, 0, 0, 10]},
        "removed": ["9"], "hidden": ["7"]})";
    return {
        R"({"do": "scan", "id": 7, "time_s": 1.5, "place": [1, 2, 3, 10, 0, 0], "sensor": "VLP-16", "lidar": 0,
        "weather": "fog=50,rain=2", "simulate": true, "real": false, "edits": )" +
            edits + "}",
        R"({"do": "sensor", "file": "beams.csv", "text": "elevation_deg\n1\n"})",
        R"({"do": "save", "name": "run2", "edits": )" + edits + "}"};
}

void read_request(std::string_view input, const fs::path&) { (void)view::parse_request(std::string(input)); }

#ifdef RELIDAR_FUZZ_VIEW

std::vector<std::string> make_head_seeds(const fs::path&) {
    return {
        "localhost:8080\nhttp://localhost:8080\na=1; "
        "relidar_8080=0123456789abcdef\ntoken=0123456789abcdef&b=2",
        "[::1]:80\nhttp://[::1]\n\n", "127.0.0.1\n\n\n"};
}

void read_head(std::string_view input, const fs::path&) {
    std::string_view lines[4];
    for (std::string_view& line : lines) {
        line = input.substr(0, input.find('\n'));
        input.remove_prefix(std::min(input.size(), line.size() + 1));
    }
    (void)view::is_this_machine(lines[0], "machine");
    (void)view::is_same_origin(lines[1], lines[0]);
    constexpr std::string_view kToken = "0123456789abcdef";
    const bool shown = view::is_same_secret(view::find_list_value(lines[3], "token", '&'), kToken) ||
                       view::is_same_secret(view::find_list_value(lines[2], "relidar_8080", ';'), kToken);
    const bool there =
        (std::string(lines[2]) + std::string(lines[3])).find("0123456789abcdef") != std::string::npos;
    // aborts if access is granted although the request does not contain the token
    if (shown && !there) std::abort();
}

#endif
#ifdef RELIDAR_FUZZ_SERVE

struct Served {
    std::vector<Run> outlines;
    std::vector<serve::SceneSource> sources;
    serve::AssetCatalogue assets{{}};
    serve::SpawnedActorRegistry spawned{1};

    explicit Served(const fs::path& folder) : sources{{"town", folder}} {
        Run run = make_example_run(folder);
        run.scene = wrap_background({});
        for (const BoxTrack& box : run.sequence.boxes) {
            ModelInstance instance;
            instance.track = box.id;
            run.scene.instances.push_back(instance);
        }
        outlines.push_back(std::move(run));
    }
};

template <class Message>
Message parse_message(std::string_view bytes) {
    Message message;
    if (!message.ParseFromArray(bytes.data(), int(bytes.size()))) throw DataError("no message of that kind");
    return message;
}

void silence_protobuf() {
#if GOOGLE_PROTOBUF_VERSION < 4022000
    // silences protobuf, which prints a line for each text that is not UTF-8
    static const auto silenced = google::protobuf::SetLogHandler(nullptr);
    (void)silenced;
#endif
}

/// Throws a usage error if the status blames the client, otherwise a bug.
void check_status(const grpc::Status& status) {
    if (status.ok()) return;
    const grpc::StatusCode code = status.error_code();
    const bool of_client = code == grpc::StatusCode::INVALID_ARGUMENT ||
                           code == grpc::StatusCode::NOT_FOUND ||
                           status.error_message() == "no message of that kind";
    throw Error(of_client ? ExitCode::usage : ExitCode::bug, status.error_message());
}

/// Reads a call. The first byte selects its type.
void read_call(std::string_view input, const fs::path& folder) {
    static const Served served(folder);
    silence_protobuf();
    if (input.empty()) return;
    // uploaded data is released with the reader
    serve::RequestReader reader(served.outlines, served.sources, served.assets, served.spawned);
    const unsigned call = static_cast<unsigned char>(input[0]) % 4u;
    input.remove_prefix(1);
    const grpc::Status status = serve::call_handler([&] {
        if (call == 0) (void)reader.read_request(parse_message<v1::RenderLidarRequest>(input));
        if (call == 1) (void)reader.read_rig(parse_message<v1::RenderRigRequest>(input));
        if (call == 2) (void)reader.cache_sensor(parse_message<v1::UploadSensorRequest>(input).sensor());
        if (call == 3) {
            const auto request = parse_message<v1::GetTracksRequest>(input);
            const std::size_t scene = reader.find_scene(request.scene());
            v1::GetTracksResponse answer;
            serve::write_tracks(served.outlines[scene], reader.find_lidar(scene, request.lidar()),
                                request.actors(), answer);
        }
    });
    check_status(status);
}

void read_frame(std::string_view input, const fs::path& folder) {
    static const Served served(folder);
    static const serve::RequestReader scenes(served.outlines, served.sources, served.assets, served.spawned);
    static serve::SensorsimReader reader(served.outlines, scenes,
                                         serve::PoseTransformOrder::translation_first);
    silence_protobuf();
    check_status(serve::call_handler(
        [&] { (void)reader.read_request(parse_message<serve::sensorsim::LidarRenderRequest>(input)); }));
}

std::vector<std::string> make_frame_seeds(const fs::path&) {
    serve::sensorsim::LidarRenderRequest request;
    request.set_scene_id("town");
    request.mutable_lidar()->set_lidar_type(serve::sensorsim::AT128);
    request.set_frame_start_us(1'000'000);
    request.set_frame_end_us(1'100'000);
    serve::sensorsim::Pose& pose = *request.mutable_sensor_pose()->mutable_start();
    pose.mutable_translation()->set_x(2.0f);
    pose.mutable_rotation()->set_w(1.0f);
    *request.mutable_sensor_pose()->mutable_end() = pose;
    serve::sensorsim::DynamicObject& object = *request.add_dynamic_objects();
    object.set_track_id("7");
    *object.mutable_pose() = request.sensor_pose();
    return {request.SerializeAsString()};
}

void add_pose(v1::TimedPose& timed, double time_s) {
    timed.set_time_s(time_s);
    timed.mutable_pose()->mutable_translation()->set_x(2.0 * time_s);
    timed.mutable_pose()->mutable_rotation()->set_w(1.0);
}

v1::RenderLidarRequest scan_request(const char* sensor) {
    v1::RenderLidarRequest request;
    request.mutable_sensor()->set_name(sensor);
    add_pose(*request.add_path(), 0.25);
    add_pose(*request.add_path(), 0.5);
    request.set_time_s(0.375);
    v1::ActorTrack& actor = *request.mutable_actors()->add_actors();
    actor.set_name("7");
    add_pose(*actor.add_poses(), 0.25);
    request.set_sample_seed(3);
    request.mutable_wanted()->set_points(true);
    return request;
}

std::vector<v1::SensorSpec> make_sensor_specs() {
    std::vector<v1::SensorSpec> specs(4);
    auto& spinning = *specs[0].mutable_spinning();
    spinning.add_beams()->set_elevation_rad(0.1);
    spinning.add_beams()->set_elevation_rad(-0.1);
    spinning.set_columns(16);
    spinning.set_period_s(0.1);
    auto& window = *specs[1].mutable_window();
    window.set_rows(4);
    window.set_columns(4);
    window.set_left_rad(0.5);
    window.set_right_rad(-0.5);
    window.set_top_rad(0.2);
    window.set_bottom_rad(-0.2);
    window.set_period_s(0.1);
    auto& rosette = *specs[2].mutable_rosette();
    rosette.set_rays(16);
    rosette.set_deflection_rad(0.2);
    rosette.set_first_hz(100);
    rosette.set_second_hz(-60);
    rosette.set_period_s(0.1);
    const float directions[6] = {1.0f, 0.0f, 0.0f, 0.0f, 1.0f, 0.0f};
    specs[3].mutable_rays()->set_direction(directions, sizeof directions);
    return specs;
}

std::vector<std::string> make_call_seeds(const fs::path&) {
    const auto seed = [](char call, const auto& message) { return call + message.SerializeAsString(); };
    std::vector<std::string> seeds{seed(0, scan_request("VLP-16:16x10"))};
    v1::RenderRigRequest rig;
    *rig.mutable_rig() = scan_request("");
    rig.add_sensors()->mutable_sensor()->set_name("VLP-16:16x10");
    rig.mutable_sensors(0)->mutable_rig_from_sensor()->mutable_translation()->set_z(1.5);
    seeds.push_back(seed(1, rig));
    for (const v1::SensorSpec& spec : make_sensor_specs()) {
        v1::UploadSensorRequest upload;
        *upload.mutable_sensor() = spec;
        seeds.push_back(seed(2, upload));
        v1::RenderLidarRequest request = scan_request("");
        *request.mutable_sensor()->mutable_spec() = spec;
        seeds.push_back(seed(0, request));
    }
    v1::GetTracksRequest tracks;
    tracks.set_scene("town");
    tracks.add_actors("7");
    seeds.push_back(seed(3, tracks));
    return seeds;
}

#endif

}  // namespace

std::vector<Harness> list_request_harnesses() {
    return {{"wish", make_request_seeds, read_request},
#ifdef RELIDAR_FUZZ_VIEW
            {"head", make_head_seeds, read_head},
#endif
#ifdef RELIDAR_FUZZ_SERVE
            {"call", make_call_seeds, read_call},
            {"frame", make_frame_seeds, read_frame}
#endif
    };
}

}  // namespace relidar::fuzz
