// SPDX-License-Identifier: Apache-2.0
// The command `relidar serve` renders scans for simulators, which connect through gRPC.
// Ctrl-C ends the command.
#include <chrono>
#include <memory>
#include <optional>
#include <thread>

#ifdef __GLIBC__
#include <malloc.h>
#endif

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <CLI/CLI.hpp>

#include "../../network/descriptors.hpp"
#include "../../network/host_port.hpp"
#include "../../network/loopback.hpp"
#include "../../serve/server.hpp"
#include "base/fail.hpp"
#include "command.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "render/render_notes.hpp"

namespace relidar::cli {
namespace {

struct ServeCommandOptions {
    serve::ServerOptions server;
    std::string api, pose_order, weather;
    int queue = 64;
    int memory_mib = 0;
    DeviceCommandOptions device;
    bool quiet = false;
};

constexpr int kLongestQueue = 10'000;
// For pending calls after Ctrl-C.
constexpr std::chrono::seconds kMaxDrainTime{30};
constexpr std::chrono::milliseconds kPollInterval{100};
// After the GPU is lost, so that the clients receive the error.
constexpr std::chrono::seconds kErrorSendTime{2};

/// Returns how clients of the interface "sensorsim" write poses, or no value if the
/// interface is disabled.
std::optional<serve::PoseTransformOrder> parse_pose_order(const ServeCommandOptions& options) {
    const bool has_sensorsim = options.api == "sensorsim";
    if (!has_sensorsim && !options.api.empty())
        fail<UsageError>("--api: found '{}', expected sensorsim", options.api);
    if (!has_sensorsim && !options.pose_order.empty())
        throw UsageError("--sensorsim-poses can only be used together with --api sensorsim");
    if (!has_sensorsim) return {};
    if (options.pose_order.empty() || options.pose_order == "rotation-first")
        return serve::PoseTransformOrder::rotation_first;
    if (options.pose_order == "translation-first") return serve::PoseTransformOrder::translation_first;
    fail<UsageError>("--sensorsim-poses: found '{}', expected rotation-first or translation-first",
                     options.pose_order);
}

/// Checks all options of the command and returns the settings of the server.
serve::ServerOptions server_options(const ServeCommandOptions& options) {
    if (options.queue < 1 || options.queue > kLongestQueue)
        fail<UsageError>("--queue: found {}; expected a number from 1 to {}", options.queue, kLongestQueue);
    if (options.memory_mib < 0)
        fail<UsageError>("--memory-mib: found {}, expected 0 or more", options.memory_mib);
    if (options.server.tls_cert.empty() != options.server.tls_key.empty())
        throw UsageError("--tls-cert and --tls-key must be used together; found only one of them");
    serve::ServerOptions server = options.server;
    server.waiting = std::size_t(options.queue);
    server.memory_mib = std::uint64_t(options.memory_mib);
    server.sensorsim = parse_pose_order(options);
    // Called only for its error.
    constexpr int kMinPort = 0;  // selects a free port
    (void)parse_host_port(server.listen, "--listen", kMinPort);
    server.weather = parse_weather(options.weather);
    server.device = to_device_options(options.device);
    return server;
}

/// By default, glibc gives each thread its own heap, and gRPC often starts and ends
/// threads. One thread allocates a scan and another frees it, so that the memory of the
/// process would grow for hours (docs/service.md).
void limit_arenas() {
#ifdef __GLIBC__
    mallopt(M_ARENA_MAX, 1);
#endif
}

/// Serves runs until Ctrl-C, then waits for pending calls. If the GPU is lost, ends with
/// an error, so that the process can be restarted. The server has its own threads, so
/// this thread only polls.
void run_serve(const ServeCommandOptions& options) {
    limit_arenas();
    raise_file_limit();
    const serve::ServerOptions server_settings = server_options(options);
    if (!options.quiet) note_weather(server_settings.weather);
    const std::string host = server_settings.listen.substr(0, server_settings.listen.rfind(':'));
    const bool is_encrypted = !server_settings.tls_cert.empty();
    if (!is_loopback(host))
        print_note(fmt::format(
            "--listen {}: every client that can reach this address can render and upload, because there is "
            "no authentication{}",
            server_settings.listen,
            is_encrypted ? "" : ", and nothing is encrypted (--tls-cert, --tls-key)"));

    install_handlers();
    serve::ScanServer server(server_settings);
    if (!options.quiet) {
        print(fmt::format("serving {} at {}:{} on {}\n", fmt::join(server.list_scenes(), ", "), host,
                          server.port(), server.device_name()));
        // Another program may wait for the line through a pipe.
        std::fflush(stdout);
    }
    while (!is_interrupted()) {
        if (const std::optional<std::string> loss = server.loss_message()) {
            server.stop_and_wait(kErrorSendTime);
            throw DeviceError(*loss);
        }
        std::this_thread::sleep_for(kPollInterval);
    }
    if (!options.quiet)
        print_note("interrupted: finishing the pending calls; a second Ctrl-C ends immediately");
    server.stop_and_wait(kMaxDrainTime);
}

constexpr const char* kServeHelp =
    R"(tools/serve/relidar/v1/render.proto defines the calls, docs/service.md describes them. gRPC's
health service and reflection are included. For CARLA, ROS 2 and other simulators see
docs/simulators.md. Ctrl-C finishes the calls in progress. A second Ctrl-C ends immediately.
Examples:
  relidar serve run
  relidar serve run --assets assets
  relidar serve run --api sensorsim
  relidar serve town=runs/17 motorway=runs/18 --listen 0.0.0.0:50051 --tls-cert cert.pem --tls-key key.pem)";

}  // namespace

/// Adds the command `relidar serve` and its options to the parser.
void add_serve(CLI::App& app, ParsedCommand& call) {
    CLI::App* command = app.add_subcommand("serve", "render scans of runs for simulators through gRPC");
    const auto options = std::make_shared<ServeCommandOptions>();
    command
        ->add_option("RUN", options->server.runs,
                     "run folders of `relidar train`; clients select a run by its folder's name, or by NAME")
        ->required()
        ->type_name("[NAME=]RUN");
    add_option(*command, "--listen HOST:PORT", options->server.listen,
               "address and port; port 0 selects a free port (default: 127.0.0.1:50051)");
    add_option(*command, "--memory-mib N", options->memory_mib,
               "device memory for all scenes together; above the limit the least recently used scene is "
               "unloaded (default: half of the device memory)");
    add_list_option(*command, "--assets FOLDER", options->server.assets,
                    "folder of `relidar assets`; clients can insert its assets into any scene (repeatable)");
    add_option(*command, "--api NAME", options->api,
               "sensorsim: also answer, at the same port, the LiDAR calls of SensorsimService, which AlpaSim "
               "and CARLA use to call NVIDIA's renderer");
    add_option(*command, "--sensorsim-poses ORDER", options->pose_order,
               "order in which a pose of SensorsimService transforms a point: rotation-first (R p + t, the "
               "default) or translation-first (R (p + t))");
    add_channels_option(*command, options->server.channels);
    add_weather_option(*command, options->weather,
                       "scans whose request sets no weather; the random seed of the weather is the request's "
                       "sample_seed, or 0 if the request has no sample_seed");
    add_option(*command, "--queue N", options->queue,
               "maximum number of waiting calls; further calls fail with RESOURCE_EXHAUSTED (default: 64)");
    add_option(*command, "--tls-cert FILE", options->server.tls_cert,
               "certificate chain in PEM; turns on encryption, together with --tls-key");
    add_option(*command, "--tls-key FILE", options->server.tls_key, "private key of the certificate in PEM");
    add_device_options(*command, options->device);
    add_quiet_option(*command, options->quiet);
    command->footer(kServeHelp);
    run_after_parsing(*command, call, options, run_serve);
}

}  // namespace relidar::cli
