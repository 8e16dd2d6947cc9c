// SPDX-License-Identifier: Apache-2.0
// The command `relidar-dev bench` measures a training iteration on a benchmark street or
// on a run. It reports kernel times, rays per second and memory.
#include <memory>
#include <optional>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/base/files.hpp>
#include "actors.hpp"
#include "commands.hpp"
#include "console.hpp"
#include "dev_case.hpp"
#include "floor.hpp"
#include "gpu/copy_rate.hpp"
#include "interrupt.hpp"
#include "measure.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "scans.hpp"
#include "serve.hpp"
#include "steps.hpp"
#include "text.hpp"

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

std::vector<int> parse_actor_counts(const std::string& list) {
    std::vector<int> counts;
    for (const double n : parse_number_list("--actors", list)) {
        if (!(n >= 1.0 && n <= kMaxActors) || n != static_cast<int>(n))
            throw UsageError(fmt::format("--actors: found {} in \"{}\", expected whole numbers from 1 to {}",
                                         n, list, kMaxActors));
        counts.push_back(static_cast<int>(n));
    }
    return counts;
}

void run_actor_benchmark(const BenchOptions& options, Device& device, const std::string& command_line) {
    std::vector<ActorBenchTimes> times;
    for (const int n : parse_actor_counts(options.actors))
        for (const bool copy_shared_models : {false, true})
            times.push_back(measure_actor_times(device, n, copy_shared_models, options.settings));
    end_progress_line();
    if (!options.json.empty())
        write_text_file(options.json, make_actor_times_json(times, device, command_line));
    if (!options.settings.quiet) print(format_actor_times(times));
}

void run_scan_benchmark(const BenchOptions& options, Device& device, const std::string& command_line) {
    ScanBenchOptions bench = options.scans;
    bench.run = options.choice.run;
    bench.sensor = options.service.sensor;
    const ScanBenchTimes times = measure_scan_times(device, bench);
    if (!options.json.empty())
        write_text_file(options.json, make_scan_times_json(times, device, command_line));
    if (!options.settings.quiet) print(format_scan_times(times));
}

void run_training_step_benchmark(const BenchOptions& options, Device& device,
                                 const std::string& command_line) {
    const TrainingStepTimes times =
        measure_training_steps(device, options.choice.run, options.n_steps, options.settings.quiet);
    if (!options.json.empty())
        write_text_file(options.json, make_step_times_json(times, device, command_line));
    if (!options.settings.quiet) print(format_step_times(times, device));
}

void run_bench_command(const BenchOptions& options, const std::string& command_line) {
    if (!options.service.address.empty()) return run_service_benchmark(options.service);
    require_valid_bench_options(options.choice);
    if (!options.choice.run.empty() && options.describes_street)
        throw UsageError(
            "--run: found --scene, --surfels or --rays in the same command; expected only --run, because the "
            "run defines scene and rays");
    BenchSettings settings = options.settings;
    settings.backward = !options.no_backward;
    if (settings.repeat < 1 || settings.repeat > kMaxRepeat)
        throw UsageError(
            fmt::format("--repeat: found {}, expected a number from 1 to {}", settings.repeat, kMaxRepeat));
    const std::filesystem::path json = options.json;
    if (std::error_code failed; std::filesystem::is_directory(json, failed))
        throw DataError(fmt::format("--json {}: found a folder, expected the name of a file", options.json));
    if (!options.actors.empty()) parse_actor_counts(options.actors);
    if (options.scans.n_scans != 0 && options.choice.run.empty())
        throw UsageError("--scans: the option --run is missing; expected --run RUN with the run to render");
    if (options.n_steps != 0 && options.choice.run.empty())
        throw UsageError("--steps: the option --run is missing; expected --run RUN with the run to train");
    if (options.n_steps != 0 && options.scans.n_scans != 0)
        throw UsageError(
            "--steps: found --scans in the same command; expected only one of them, because --scans measures "
            "rendering and --steps measures training");
    if (options.n_steps < 0 || options.n_steps > kMostTimedSteps)
        throw UsageError(fmt::format("--steps: found {}, expected a number from 1 to {}", options.n_steps,
                                     kMostTimedSteps));
    std::optional<OutputFolder> folder;
    if (!json.empty()) folder.emplace(json.has_parent_path() ? json.parent_path() : ".");
    Device device(convert_to_device_options(options.device));

    install_interrupt_handlers();
    if (!options.actors.empty()) return run_actor_benchmark(options, device, command_line);
    if (options.scans.n_scans != 0) return run_scan_benchmark(options, device, command_line);
    if (options.n_steps != 0) return run_training_step_benchmark(options, device, command_line);
    const DevCase bench = make_benchmark_from_options(options.choice);
    BenchResult result = run_benchmark(device, bench, settings);
    // The copy bandwidth is measured last, when the memory of the scene is free again.
    result.copy_bytes_per_s = measure_copy_bandwidth_bytes_per_s(device);
    end_progress_line();
    if (!json.empty())
        write_text_file(json, make_bench_result_json(bench, settings, result, device, command_line));
    if (!settings.quiet) print(format_bench_result(bench, result, device));
}

void add_training_benchmark_options(CLI::App& command, BenchCaseOptions& bench_choice) {
    command
        .add_option("--keep-hits", bench_choice.keep_hits,
                    "number of hits per ray that the forward pass stores for the backward pass; 0: the "
                    "backward pass traces all rays again (default: at least 64, or the value of the run)")
        ->type_name("N");
    command
        .add_option("--likelihood", bench_choice.likelihood,
                    "weight of loss.likelihood (default: 0, or the value of the run)")
        ->type_name("WEIGHT");
    command.add_flag("--deterministic", bench_choice.deterministic,
                     "add gradients in a fixed order instead of with atomic operations");
}

void add_scan_benchmark_options(CLI::App& command, BenchOptions& options) {
    command
        .add_option("--actors", options.actors,
                    "measure scans, training and moves with this number of copies of an actor of 1000 "
                    "surfels; several numbers are separated by commas")
        ->type_name("LIST");
    command
        .add_option("--scans", options.scans.n_scans,
                    "instead measure this number of complete scans along the path of --run")
        ->type_name("N");
    command
        .add_option("--together", options.scans.together,
                    "number of scans of --scans that are submitted to the device together; a GPU renders "
                    "them in parallel (default: all sensors of a rig, otherwise 1)")
        ->type_name("N");
    command
        .add_option("--steps", options.n_steps,
                    "instead measure this number of training steps that continue --run: the time of each "
                    "kernel and the time between kernels")
        ->type_name("N");
    command.add_flag("--sampled", options.scans.sampled,
                     "with --scans: draw random drops and noise, like `relidar render --sample`");
    ServeBenchOptions& service = options.service;
    command
        .add_option("--serve", service.address,
                    "instead measure calls of a running `relidar serve` at this address")
        ->type_name("HOST:PORT");
    command
        .add_option("--serve-scene", service.scene,
                    "with --serve: name of the scene to render (default: the first)")
        ->type_name("NAME");
    command
        .add_option("--sensor", service.sensor,
                    "with --scans or --serve: sensor to render, from `relidar list sensors`, for example "
                    "HDL-32E:512x10; with --scans also a rig (default: the sensor of the log)")
        ->type_name("NAME|RIG.json");
    command
        .add_option("--clients", service.clients,
                    "with --serve: number of clients that call at the same time (default: 1)")
        ->type_name("N");
    command
        .add_option("--calls", service.calls,
                    "with --serve: number of calls of all clients together (default: 100)")
        ->type_name("N");
}

void add_ray_tracing_options(CLI::App& command, BenchCaseOptions& bench_choice) {
    command
        .add_option("--chunk", bench_choice.chunk,
                    "number of hits of a ray that are sorted together, 1 to 64 (default: 16, or the value of "
                    "the run)")
        ->type_name("N");
    command
        .add_option("--proxy", bench_choice.proxy,
                    "shape that represents a surfel in ray queries: auto, triangles or boxes (default: auto, "
                    "or the value of the run)")
        ->type_name("WHAT");
    command
        .add_option("--walk", bench_choice.traversal_mode,
                    "unit that searches the software tree for a ray: auto, lane or subgroup (default: auto, "
                    "or the value of the run)")
        ->type_name("HOW");
    command
        .add_option("--order", bench_choice.order,
                    "how hits are sorted: chunks during the search, or complete lists after it (default: "
                    "auto, which uses lists on a GPU)")
        ->type_name("HOW");
    command
        .add_option("--sh", bench_choice.sh,
                    "evaluate spherical harmonics for each ray or once per surfel (default: ray, or the "
                    "value of the run)")
        ->type_name("ray|surfel");
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

void add_bench_command(CLI::App& app, ParsedCommand& selected_command) {
    CLI::App* command = app.add_subcommand(
        "bench", "measure the time of each kernel of a training iteration, on a synthetic street or a run");
    const auto options = std::make_shared<BenchOptions>();
    BenchCaseOptions& choice = options->choice;
    const CLI::Option* scene =
        command
            ->add_option("--scene", choice.street,
                         "synthetic street; A: surfels of 0.1 to 0.3 m; B: the more surfels, the smaller "
                         "they are; C: like B, but with opacity 0.1 (default: A)")
            ->type_name("A|B|C");
    const CLI::Option* surfels =
        command
            ->add_option("--surfels", choice.n_surfels, "number of surfels of the street (default: 100000)")
            ->type_name("N");
    const CLI::Option* rays = command
                                  ->add_option("--rays", choice.rays,
                                               "size of the image: waymo (64 x 2650), kitti (66 x 1030) or "
                                               "ROWSxCOLUMNS; +2.0 to -24.9 degrees (default: 64x1024)")
                                  ->type_name("NAME|ROWSxCOLUMNS");
    command
        ->add_option("--run", choice.run,
                     "measure a run instead of a street: its scene, and the rays of its sensor at the first "
                     "held-out frame")
        ->type_name("RUN");
    add_ray_tracing_options(*command, choice);
    add_training_benchmark_options(*command, choice);
    command
        ->add_option("--repeat", options->settings.repeat,
                     "number of measured repetitions, after a few that are not measured (default: 10)")
        ->type_name("N");
    command->add_flag(
        "--no-backward", options->no_backward,
        "measure only rendering: without loss, gradients and optimiser, and without their memory");
    add_scan_benchmark_options(*command, *options);
    command->add_option("--json", options->json, "also write the results to this file")->type_name("FILE");
    add_device_options(*command, options->device);
    add_quiet_option(*command, options->settings.quiet);
    command->footer(kBenchHelp);
    command->callback([&selected_command, options, scene, surfels, rays] {
        options->describes_street = scene->count() + surfels->count() + rays->count() > 0;
        selected_command.run = [&selected_command, options] {
            run_bench_command(*options, selected_command.command_line);
        };
    });
}

}  // namespace relidar::cli
