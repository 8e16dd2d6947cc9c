// SPDX-License-Identifier: Apache-2.0
// The command `relidar-dev bench` measures a training iteration on a benchmark street or
// on a run. It reports kernel times, rays per second and memory.
#include <memory>
#include <optional>

#include <CLI/CLI.hpp>

#include <relidar/base/files.hpp>
#include "actors.hpp"
#include "base/fail.hpp"
#include "commands.hpp"
#include "console.hpp"
#include "dev_case.hpp"
#include "floor.hpp"
#include "gpu/copy_rate.hpp"
#include "interrupt.hpp"
#include "measure.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "run_times.hpp"
#include "serve.hpp"

namespace relidar::cli {
namespace {

constexpr int kMaxRepeat = 100000;

struct BenchOptions {
    BenchCaseOptions choice;
    bool describes_street = false;  ///< True if the user gave --scene, --surfels or --rays.
    BenchSettings settings;
    bool no_backward = false;
    std::string json;
    /// Numbers of actors, such as "1,10,100". If set, measures a scene for each number of
    /// actors, instead of the benchmark street.
    std::string actors;
    ServeBenchOptions service;
    ScanBenchOptions scans;
    int n_steps = 0;  ///< Number of training steps to measure. 0 means that no steps are measured.
    DeviceCommandOptions device;
};

constexpr int kMaxActors = 1000;

/// Parses the numbers of actors of --actors, such as "1,10,100".
std::vector<int> parse_counts(const std::string& list) {
    std::vector<int> counts;
    for (const double n : parse_list("--actors", list)) {
        if (!(n >= 1.0 && n <= kMaxActors) || n != int(n))
            fail<UsageError>("--actors: found {} in \"{}\", expected whole numbers from 1 to {}", n, list,
                             kMaxActors);
        counts.push_back(int(n));
    }
    return counts;
}

/// Measures what --actors, --steps or --scans requests, instead of single kernels, and
/// returns the results as text. --actors has priority, and check_bench_options() rejects
/// --steps together with --scans. Each number of actors is measured twice: with one model
/// that all actors share, and with a copy of it for each actor.
std::string run_other_benchmark(const BenchOptions& options, Device& device) {
    if (!options.actors.empty()) {
        std::vector<ActorBenchTimes> results;
        for (const int n_actors : parse_counts(options.actors))
            for (const bool copy_shared_models : {false, true})
                results.push_back(measure_actors(device, n_actors, copy_shared_models, options.settings));
        end_progress();
        return format_actors(results);
    }
    if (options.n_steps != 0)
        return format_steps(
            measure_steps(device, options.choice.run, options.n_steps, options.settings.quiet), device);
    ScanBenchOptions scan_options = options.scans;
    scan_options.run = options.choice.run;
    scan_options.sensor = options.service.sensor;
    return format_scans(measure_scans(device, scan_options));
}

/// Rejects options that contradict each other or are out of range.
void check_bench_options(const BenchOptions& options) {
    const bool has_scans = options.scans.n_scans != 0, has_steps = options.n_steps != 0;
    const bool has_only_printed_results = !options.actors.empty() || has_scans || has_steps;
    const int n_repeats = options.settings.repeat;
    check_options(options.choice);
    if (!options.choice.run.empty() && options.describes_street)
        throw UsageError(
            "--run: found --scene, --surfels or --rays in the same command; expected only --run");
    if (n_repeats < 1 || n_repeats > kMaxRepeat)
        fail<UsageError>("--repeat: found {}, expected a number from 1 to {}", n_repeats, kMaxRepeat);
    if (has_only_printed_results && !options.json.empty())
        throw UsageError("--json: found --actors, --scans or --steps, whose results are only printed");
    if (std::error_code failed; std::filesystem::is_directory(options.json, failed))
        fail("--json {}: found a folder, expected the name of a file", options.json);
    if (!options.actors.empty()) (void)parse_counts(options.actors);  // Called only for its error.
    if (has_scans && options.choice.run.empty())
        throw UsageError("--scans: the option --run is missing; expected --run RUN with the run to render");
    if (has_steps && options.choice.run.empty())
        throw UsageError("--steps: the option --run is missing; expected --run RUN with the run to train");
    if (has_steps && has_scans)
        throw UsageError("--steps: found --scans in the same command; expected only one of them");
    if (options.n_steps < 0 || options.n_steps > kMostTimedSteps)
        fail<UsageError>("--steps: found {}, expected a number from 1 to {}", options.n_steps,
                         kMostTimedSteps);
}

/// Runs `relidar-dev bench`: measures a service, actors, scans, training steps or,
/// without such an option, each kernel of a training iteration.
void run_bench(const BenchOptions& options, const std::string& command_line) {
    if (!options.service.address.empty()) return bench_service(options.service);
    check_bench_options(options);
    BenchSettings settings = options.settings;
    settings.backward = !options.no_backward;
    std::optional<OutputFolder> folder;
    if (!options.json.empty()) folder.emplace(folder_of(options.json));
    Device device(to_device_options(options.device));

    install_handlers();
    const bool has_other = !options.actors.empty() || options.scans.n_scans != 0 || options.n_steps != 0;
    if (has_other) return print(run_other_benchmark(options, device));
    const DevCase bench = make_case(options.choice);
    BenchResult result = run_benchmark(device, bench, settings);
    // Measured last, when the memory of the scene is free again.
    result.copy_bytes_per_s = measure_bandwidth(device);
    end_progress();
    if (!options.json.empty())
        write_text_file(options.json, result_json(bench, settings, result, device, command_line));
    if (!settings.quiet) print(format_result(bench, result, device));
}

constexpr const char* kBenchHelp =
    R"(One repetition: a rebuild (proxies, bottom level, top level), an iteration (activation, refit,
forward, loss, backward, and Adam with learning rate 0, so that the scene does not change), and
one instance moved (top level). Times are device timestamps. If a kernel runs several times in an
iteration, its times are added. Mrays/s is the median of forward and backward tracing. The floor of
a kernel is the time that a copy of its minimum memory traffic takes.
Examples:
  relidar-dev bench --json bench.json
  relidar-dev bench --scene B --surfels 1000000 --rays waymo --sh surfel
  relidar-dev bench --run run --repeat 50
  relidar-dev bench --run run --scans 100
  relidar-dev bench --run run --scans 400 --sensor rig.json
  relidar-dev bench --run run --steps 100
  relidar-dev bench --keep-hits 0 --deterministic
  relidar-dev bench --actors 1,1000
  relidar-dev bench --serve 127.0.0.1:50051 --sensor HDL-32E:512x10 --clients 4)";

}  // namespace

/// Adds the command `relidar-dev bench` and its options to the parser.
void add_bench(CLI::App& app, ParsedCommand& selected_command) {
    CLI::App* command = app.add_subcommand(
        "bench", "measure the time of each kernel of a training iteration, on a synthetic street or a run");
    const auto options = std::make_shared<BenchOptions>();
    BenchCaseOptions& choice = options->choice;
    ServeBenchOptions& service = options->service;
    const auto add = [&](const char* name, auto& value, const char* text) {
        return add_option(*command, name, value, text);
    };
    const CLI::Option* scene = add("--scene A|B|C", choice.street,
                                   "synthetic street; A: surfels of 0.1 to 0.3 m; B: the more surfels, the "
                                   "smaller they are; C: like B, but with opacity 0.1 (default: A)");
    const CLI::Option* surfels =
        add("--surfels N", choice.n_surfels, "number of surfels of the street (default: 100000)");
    const CLI::Option* rays = add("--rays NAME|ROWSxCOLUMNS", choice.rays,
                                  "size of the image: waymo (64 x 2650), kitti (66 x 1030) or ROWSxCOLUMNS; "
                                  "+2.0 to -24.9 degrees (default: 64x1024)");
    add("--run RUN", choice.run,
        "measure a run instead of a street: its scene, and the rays of its sensor at the first held-out "
        "frame");
    add("--chunk N", choice.chunk,
        "number of hits of a ray that are sorted together, 1 to 64 (default: 16, or the value of the run)");
    add("--proxy WHAT", choice.proxy,
        "shape that represents a surfel in ray queries: auto, triangles or boxes (default: auto, or the "
        "value of the run)");
    add("--walk HOW", choice.traversal_mode,
        "unit that searches the software tree for a ray: auto, lane or subgroup (default: auto, or the value "
        "of the run)");
    add("--order HOW", choice.order,
        "how hits are sorted: chunks during the search, or complete lists after it (default: auto, which "
        "uses lists on a GPU)");
    add("--sh ray|surfel", choice.sh,
        "evaluate spherical harmonics for each ray or once per surfel (default: ray, or the value of the "
        "run)");
    add("--keep-hits N", choice.keep_hits,
        "number of hits per ray that the forward pass stores for the backward pass; 0: the backward pass "
        "traces all rays again (default: at least 64, or the value of the run)");
    command->add_flag("--deterministic", choice.deterministic,
                      "add gradients in a fixed order instead of with atomic operations");
    add("--repeat N", options->settings.repeat,
        "number of measured repetitions, after a few that are not measured (default: 10)");
    command->add_flag(
        "--no-backward", options->no_backward,
        "measure only rendering: without loss, gradients and optimiser, and without their memory");
    add("--actors LIST", options->actors,
        "measure scans, training and moves with this number of copies of an actor of 1000 surfels; several "
        "numbers are separated by commas");
    add("--scans N", options->scans.n_scans,
        "instead measure this number of complete scans along the path of --run");
    add("--together N", options->scans.together,
        "number of scans of --scans that are submitted to the device together; a GPU renders them in "
        "parallel (default: all sensors of a rig, otherwise 1)");
    add("--steps N", options->n_steps,
        "instead measure this number of training steps that continue --run: the time of each kernel and the "
        "time between kernels");
    add("--serve HOST:PORT", service.address,
        "instead measure calls of a running `relidar serve` at this address");
    add("--serve-scene NAME", service.scene,
        "with --serve: name of the scene to render (default: the first)");
    add("--sensor NAME|RIG.json", service.sensor,
        "with --scans or --serve: sensor to render, from `relidar list sensors`, for example HDL-32E:512x10; "
        "with --scans also a rig (default: the sensor of the log)");
    add("--clients N", service.clients,
        "with --serve: number of clients that call at the same time (default: 1)");
    add("--calls N", service.calls, "with --serve: number of calls of all clients together (default: 100)");
    add("--json FILE", options->json, "also write the times of the kernels to this file");
    add_device_options(*command, options->device);
    add_quiet_option(*command, options->settings.quiet);
    command->footer(kBenchHelp);
    command->callback([&selected_command, options, scene, surfels, rays] {
        options->describes_street = scene->count() + surfels->count() + rays->count() > 0;
        selected_command.run = [&selected_command, options] {
            run_bench(*options, selected_command.command_line);
        };
    });
}

}  // namespace relidar::cli
