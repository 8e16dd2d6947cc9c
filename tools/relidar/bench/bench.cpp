// SPDX-License-Identifier: Apache-2.0
// Measures the speed of a device and prints a report for `relidar check --speed`. The
// program `relidar-dev bench` measures each kernel instead.
#include "bench/bench.hpp"

#include <algorithm>
#include <optional>
#include <span>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/files.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/simulate/render.hpp>

#include "bench/case.hpp"
#include "bench/training_step.hpp"
#include "console.hpp"
#include "interrupt.hpp"
#include "render/selection.hpp"
#include "scene/benchmark_street.hpp"

namespace relidar::cli {
namespace {

constexpr int kMinRepeats = 3, kMaxRepeats = 10, kTimedScans = 30;
constexpr double kEnoughTime_ms = 5000.0;

/// Median wall times. Each includes waiting until the device has finished.
struct BenchTimes {
    double build_ms = 0.0, refit_ms = 0.0;
    double forward_ms = 0.0, backward_ms = 0.0;
    /// refit, forward pass, losses, backward pass and Adam in one submission
    double iteration_ms = 0.0;
    std::size_t repetitions = 0;
    std::optional<double> scans_per_s;
    std::optional<double> separate_scans_per_s = {};
};

double median(std::vector<double> samples) {
    std::ranges::sort(samples);
    return samples[samples.size() / 2];
}

/// Wall times of all repetitions, ms.
struct PhaseSamples {
    std::vector<double> build, refit, forward, backward, iteration;
};

/// Measures each part of a training iteration alone, and a complete iteration, once.
void measure_repetition(TrainingStep& step, const BenchCase& bench_case, const RayBatch& batch,
                        PhaseSamples& samples) {
    check_interrupt();
    Renderer& renderer = step.renderer;
    Stream& stream = renderer.stream();
    const auto time = [&](std::vector<double>& samples_of_phase, const auto& record) {
        const Clock::time_point start = Clock::now();
        record();
        stream.submit_and_wait();
        samples_of_phase.push_back(ms_since(start));
    };
    time(samples.iteration, [&] {
        renderer.update(bench_case.placed, bench_case.view_origin_m);
        renderer.record_forward(batch);
        step.record_losses(batch);
        step.differentiable.record_backward();
        step.record_optimizer();
    });
    constexpr bool kRebuild = true;  // builds the trees again, instead of refitting their boxes
    time(samples.build, [&] { renderer.accel().record_refit(stream, renderer.scene(), kRebuild); });
    time(samples.refit, [&] { renderer.accel().record_refit(stream, renderer.scene()); });
    time(samples.forward, [&] { renderer.record_forward(batch); });
    // Not timed: the backward pass needs the gradients of the losses.
    step.record_losses(batch);
    stream.submit_and_wait();
    time(samples.backward, [&] { step.differentiable.record_backward(); });
}

/// Renders the image of a case, without the arrays of a training.
RenderedRayValues render_case(Device& device, const BenchCase& bench_case) {
    const auto n_rays = static_cast<std::uint32_t>(bench_case.rays.size());
    Renderer renderer(device, bench_case.scene, bench_case.config.image,
                      {.trace = common_options(bench_case.config), .n_rays = n_rays});
    renderer.update(bench_case.placed, bench_case.view_origin_m);
    return renderer.render_rays(bench_case.rays);
}

/// Repeats the measurement until kEnoughTime_ms have passed, and returns the medians. The
/// targets are the rendered image plus noise, so that the gradients are not zero.
BenchTimes measure_times(Device& device, const BenchCase& bench_case) {
    const auto n_rays = static_cast<std::uint32_t>(bench_case.rays.size());
    const RendererOptions options{.trace = training_options(bench_case.config),
                                  .n_rays = n_rays,
                                  .keep_hits = static_cast<std::uint32_t>(bench_case.config.trace.keep_hits)};
    TrainingStep step(
        device, bench_case, options,
        noisy_targets(render_case(device, bench_case), bench_case.config.loss.normalised_depth));
    const Array<DeviceRay> rays(device, std::span<const DeviceRay>(to_device_rays(bench_case.rays)), "rays");
    const RayBatch batch{.rays = &rays,
                         .n_rays = n_rays,
                         .columns = static_cast<std::uint32_t>(bench_case.columns),
                         .targets = &step.targets};

    // The first launches compile kernels. A GPU raises its clock rate only under load.
    const double warm_up_ms = device.info().type == "CPU" ? 200.0 : 2000.0;
    PhaseSamples samples;
    Clock::time_point start = Clock::now();
    do measure_repetition(step, bench_case, batch, samples);
    while (ms_since(start) < warm_up_ms);

    samples = {};
    start = Clock::now();
    for (int i = 0; i < kMinRepeats || (i < kMaxRepeats && ms_since(start) < kEnoughTime_ms); ++i)
        measure_repetition(step, bench_case, batch, samples);
    BenchTimes times;
    times.build_ms = median(samples.build);
    times.refit_ms = median(samples.refit);
    times.forward_ms = median(samples.forward);
    times.backward_ms = median(samples.backward);
    times.iteration_ms = median(samples.iteration);
    times.repetitions = samples.build.size();
    return times;
}

/// Returns how many scans are rendered per second, at kTimedScans evenly spaced times of
/// the recorded path. Submits the scans of all sensors at one time together. While they
/// are read, the device renders the next scans.
double scans_per_second(ScanRenderer& renderer, const Run& run, std::span<const RenderedSensor> sensors) {
    const PoseTrack path = shift_track(run.log.lidar_track(0), run.log.world_offset_m);
    const double first_s = path.time_s.front(), length_s = path.time_s.back() - first_s;
    const auto submit = [&](int scan) {
        using Timing = ScanRenderer::SubmissionTiming;
        const double time_s = first_s + length_s * (scan + 0.5) / kTimedScans;
        for (const RenderedSensor& target : sensors) {
            const bool is_last = &target == &sensors.back();
            renderer.submit_points(target.sensor, {time_s, mount_track(path, target.mounting)}, time_s, {},
                                   is_last ? Timing::now : Timing::with_next);
        }
    };
    const auto collect = [&] {
        for (std::size_t i = 0; i < sensors.size(); ++i) renderer.wait_for_points();
    };
    // The first scans are not measured, because they allocate memory.
    submit(0);
    collect();

    const Clock::time_point start = Clock::now();
    submit(0);
    for (int scan = 1; scan <= kTimedScans; ++scan) {
        check_interrupt();
        if (scan < kTimedScans) submit(scan);
        collect();
    }
    return 1e3 * double(sensors.size()) * kTimedScans / ms_since(start);
}

/// Measures the scans per second of a sensor, or of all sensors of a rig together. For
/// a rig, also measures its sensors one after the other.
void measure_rates(Device& device, const Run& run, const std::string& sensor, BenchTimes& times) {
    ScanRenderer renderer(device, run);
    const std::vector<RenderedSensor> sensors =
        list_sensors(sensor.empty() ? "native" : sensor, read_sensor_rig(sensor), run, 0);
    times.scans_per_s = scans_per_second(renderer, run, sensors);
    if (sensors.size() == 1) return;
    // Sum of the times per scan, 1 / rate, of all sensors.
    double seconds = 0.0;
    for (const RenderedSensor& target : sensors)
        seconds += 1.0 / scans_per_second(renderer, run, {&target, 1});
    times.separate_scans_per_s = double(sensors.size()) / seconds;
}

const char* backend_name(const Device& device) {
    return device.backend() == RayTracingBackend::software ? "software" : "ray_query";
}

/// Returns the measured times as text. The rates are million rays per second.
std::string format_report(const BenchCase& bench_case, const BenchTimes& bench_times, const Device& device) {
    // krays / ms = Mrays / s
    const double krays = double(bench_case.rays.size()) / 1000.0;
    std::string text = fmt::format(
        "device      {}\ndriver      {}\ntraversal   {}\nscene       {}, {} surfels, {} rays ({} x {})\n",
        device.info().name, device.info().driver, backend_name(device), bench_case.name,
        bench_case.scene.surfels.size(), bench_case.rays.size(), bench_case.rows, bench_case.columns);
    text += fmt::format(
        "tree        build {:.2f} ms, refit {:.2f} ms\nforward     {:.2f} ms, {:.3f} Mrays/s\n"
        "backward    {:.2f} ms, {:.3f} Mrays/s\niteration   {:.2f} ms of training on all rays\n",
        bench_times.build_ms, bench_times.refit_ms, bench_times.forward_ms, krays / bench_times.forward_ms,
        bench_times.backward_ms, krays / bench_times.backward_ms, bench_times.iteration_ms);
    if (bench_times.scans_per_s)
        text += fmt::format("scans       {:.1f} per second\n", *bench_times.scans_per_s);
    if (bench_times.separate_scans_per_s)
        text += fmt::format("            {:.1f} per second if the sensors are rendered one after the other\n",
                            *bench_times.separate_scans_per_s);
    return text + fmt::format("relidar {}; wall times, medians of {} repetitions\n", RELIDAR_VERSION,
                              bench_times.repetitions);
}

/// Returns the measured times for --json.
std::string report_json(const BenchCase& bench_case, const BenchTimes& bench_times, const Device& device) {
    // krays / ms = Mrays / s
    const double krays = double(bench_case.rays.size()) / 1000.0;
    nlohmann::ordered_json json = {{"format", "relidar check --speed"},
                                   {"version", 2},
                                   {"relidar", RELIDAR_VERSION},
                                   {"device", device.info().name},
                                   {"driver", device.info().driver},
                                   {"traversal", backend_name(device)},
                                   {"scene", bench_case.name},
                                   {"surfels", bench_case.scene.surfels.size()},
                                   {"rays", bench_case.rays.size()},
                                   {"build_ms", bench_times.build_ms},
                                   {"refit_ms", bench_times.refit_ms},
                                   {"forward_ms", bench_times.forward_ms},
                                   {"backward_ms", bench_times.backward_ms},
                                   {"iteration_ms", bench_times.iteration_ms},
                                   {"forward_mrays_per_s", krays / bench_times.forward_ms},
                                   {"backward_mrays_per_s", krays / bench_times.backward_ms},
                                   {"repetitions", bench_times.repetitions}};
    if (bench_times.scans_per_s) json["scans_per_s"] = *bench_times.scans_per_s;
    if (bench_times.separate_scans_per_s) json["separate_scans_per_s"] = *bench_times.separate_scans_per_s;
    return json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

}  // namespace

void run_bench(const BenchOptions& options) {
    std::optional<Run> run;
    if (!options.run.empty()) run = load_run(options.run);
    Device device(to_device_options(options.device));
    // Without a run: 100,000 surfels, 64 x 1024 rays from 2.0 to -24.9 degrees.
    const BenchCase bench =
        run ? case_of_run(*run) : street_case(100000, false, make_street_rays(64, 1024, 2.0, -24.9));
    BenchTimes times = measure_times(device, bench);
    if (run) measure_rates(device, *run, options.sensor, times);
    if (!options.json.empty()) write_text_file(options.json, report_json(bench, times, device));
    print(format_report(bench, times, device));
}

}  // namespace relidar::cli
