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

void read_request(std::string_view input, const fs::path&) { (void)view::parse_request(std::string(input)); }

#ifdef RELIDAR_FUZZ_VIEW

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
        for (const BoxTrack& box : run.log.boxes) {
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

#endif

}  // namespace

std::vector<Harness> list_request_harnesses() {
    return {{"wish", nullptr, read_request},
#ifdef RELIDAR_FUZZ_VIEW
            {"head", nullptr, read_head},
#endif
#ifdef RELIDAR_FUZZ_SERVE
            {"call", nullptr, read_call},
            {"frame", nullptr, read_frame}
#endif
    };
}

}  // namespace relidar::fuzz
