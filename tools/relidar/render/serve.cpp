// SPDX-License-Identifier: Apache-2.0
// relidar serve: scans of runs for simulators, by gRPC, until Ctrl-C.
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
#include "command.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "options.hpp"
#include "render/render_notes.hpp"

namespace relidar::cli {
namespace {

struct ServeOptions {
    serve::ServerOptions server;
    std::string api, pose_order, weather;
    int queue = 64;
    int memory_mib = 0;
    DeviceChoice device;
    bool quiet = false;
};

constexpr int kLongestQueue = 10'000;
constexpr std::chrono::seconds kPatience{30};  // for calls in work when Ctrl-C comes
constexpr std::chrono::milliseconds kLook{100};
constexpr std::chrono::seconds kFarewell{2};  // for clients to hear of a lost device

/// Of the interface beside ours, where one is wanted.
std::optional<serve::PoseOrder> sensorsim_poses(const ServeOptions& options) {
    const bool offered = options.api == "sensorsim";
    if (!offered && !options.api.empty())
        throw UsageError(fmt::format("--api: found '{}', expected sensorsim", options.api));
    if (!offered && !options.pose_order.empty())
        throw UsageError("--sensorsim-poses: found it without --api sensorsim, expected both or none");
    if (!offered) return {};
    if (options.pose_order.empty() || options.pose_order == "rotation-first")
        return serve::PoseOrder::rotation_first;
    if (options.pose_order == "translation-first") return serve::PoseOrder::translation_first;
    throw UsageError(fmt::format(
        "--sensorsim-poses: found '{}', expected rotation-first or translation-first", options.pose_order));
}

serve::ServerOptions server_options(const ServeOptions& options) {
    if (options.queue < 1 || options.queue > kLongestQueue)
        throw UsageError(fmt::format("--queue: found {}, expected 1 to {}", options.queue, kLongestQueue));
    if (options.memory_mib < 0)
        throw UsageError(fmt::format("--memory-mib: found {}, expected 0 or more", options.memory_mib));
    if (options.server.tls_cert.empty() != options.server.tls_key.empty())
        throw UsageError("--tls-cert and --tls-key: found one of them, expected both or none");
    serve::ServerOptions server = options.server;
    server.waiting = std::size_t(options.queue);
    server.memory_mib = std::uint64_t(options.memory_mib);
    server.sensorsim = sensorsim_poses(options);
    (void)parse_host_port(server.listen, "--listen", 0);
    server.weather = parse_weather(options.weather);
    server.device = device_options(options.device);
    return server;
}

/// One heap for all threads. gRPC's come and go, and glibc gives them heaps of their own:
/// scans and sensors that are made on one thread and let go on another leave gaps in
/// each, so that the process grows for hours although what it uses does not.
void share_one_heap() {
#ifdef __GLIBC__
    mallopt(M_ARENA_MAX, 1);
#endif
}

void run_serve(const ServeOptions& options) {
    share_one_heap();
    raise_descriptor_limit();
    const serve::ServerOptions wanted = server_options(options);
    if (!options.quiet) note_weather(wanted.weather);
    const std::string host = wanted.listen.substr(0, wanted.listen.rfind(':'));
    if (!is_loopback(host))
        note(fmt::format(
            "--listen {}: whoever reaches this address can render and upload, there is no authentication{}",
            wanted.listen,
            wanted.tls_cert.empty() ? ", and nothing is encrypted (--tls-cert, --tls-key)" : ""));
    catch_interrupts();
    serve::ScanServer server(wanted);
    if (!options.quiet) {
        print(fmt::format("serving {} at {}:{} on {}\n", fmt::join(server.scenes(), ", "), host,
                          server.port(), server.device_name()));
        std::fflush(stdout);  // for who waits for the line through a pipe
    }
    while (!interrupted()) {
        if (const std::optional<std::string> loss = server.device_loss()) {
            server.stop(kFarewell);
            throw DeviceError(*loss);
        }
        std::this_thread::sleep_for(kLook);
    }
    if (!options.quiet) note("interrupted: calls in work are finished, a second Ctrl-C ends at once");
    server.stop(kPatience);
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

void add_serve(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand("serve", "render scans of runs for simulators, by gRPC");
    const auto options = std::make_shared<ServeOptions>();
    command
        ->add_option("RUN", options->server.runs,
                     "run folders of `relidar train`; clients call each by its folder's name, or by NAME")
        ->required()
        ->type_name("[NAME=]RUN");
    command
        ->add_option("--listen", options->server.listen,
                     "address and port; port 0 takes a free one (default: 127.0.0.1:50051)")
        ->type_name("HOST:PORT");
    command
        ->add_option("--memory-mib", options->memory_mib,
                     "device memory that scenes may hold together; beyond it the one used longest ago goes "
                     "(default: half of the device's)")
        ->type_name("N");
    command
        ->add_option(
            "--assets", options->server.assets,
            "folders of `relidar assets`: what is in them can be put into any scene by clients (repeatable)")
        ->type_name("FOLDER")
        ->allow_extra_args(false);
    command
        ->add_option("--api", options->api,
                     "sensorsim: answer, beside our own calls and at the same port, the LiDAR calls of "
                     "SensorsimService, by which AlpaSim "
                     "and CARLA call NVIDIA's renderer")
        ->type_name("NAME");
    command
        ->add_option("--sensorsim-poses", options->pose_order,
                     "what a pose of SensorsimService does to a point first: rotation-first (R p + t, the "
                     "default) or translation-first "
                     "(R (p + t))")
        ->type_name("ORDER");
    add_channels_option(*command, options->server.channels);
    add_weather_option(*command, options->weather,
                       "scans whose request names none, drawn by its sample_seed, 0 without");
    command
        ->add_option("--queue", options->queue,
                     "calls that may wait; more are turned away with RESOURCE_EXHAUSTED (default: 64)")
        ->type_name("N");
    command
        ->add_option("--tls-cert", options->server.tls_cert,
                     "certificate chain in PEM: encrypts, with --tls-key")
        ->type_name("FILE");
    command->add_option("--tls-key", options->server.tls_key, "its key in PEM")->type_name("FILE");
    add_device_options(*command, options->device);
    command->add_flag("--quiet", options->quiet, "print errors and warnings only");
    command->footer(kServeHelp);
    command->callback([&call, options] { call.run = [options] { run_serve(*options); }; });
}

}  // namespace relidar::cli
