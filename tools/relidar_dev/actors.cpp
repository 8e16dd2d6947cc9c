// SPDX-License-Identifier: Apache-2.0
#include "actors.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/diff/accel.hpp>
#include <relidar/scene/device_scene.hpp>
#include "console.hpp"
#include "dev_case.hpp"
#include "interrupt.hpp"
#include "scene/benchmark_street.hpp"

namespace relidar::cli {
namespace {

constexpr int kImageRows = 64, kImageColumns = 1024;
constexpr double kHighestBeam_deg = 2.0, kLowestBeam_deg = -24.9;  // elevations of the HDL-64E

/// Returns a scene of actors. They share one model, or each has a copy of it.
Scene make_actor_scene(int n_actors, bool copy_shared_models) {
    // A test actor is the benchmark street, scaled down to a length of about 4 m.
    constexpr float kHalfLength_m = 2.0f;
    Surfels actor = make_street_surfels(kActorSurfels);
    float longest = 0.0f;
    for (const glm::vec3& mean : actor.mean) longest = std::max(longest, glm::length(mean));
    for (glm::vec3& mean : actor.mean) mean *= kHalfLength_m / longest;
    // Model 0 is the background, which has no surfels. Model 1 has all surfels.
    Scene scene = wrap_background({});
    scene.models.push_back({.name = "actor", .first = 0, .count = kActorSurfels});
    scene.surfels = actor.reorder(kd_tree_order(actor.mean));
    for (int i = 0; i < n_actors; ++i) scene.instances.push_back({.model = 1, .track = fmt::format("{}", i)});
    return copy_shared_models ? relidar::unshare_models(std::move(scene)) : scene;
}

/// Returns the poses of all actors. The first actor is 8 m ahead of the sensor. The other
/// actors are placed on a spiral, about 5 m apart. Each step moves all actors by 1 cm.
std::vector<InstancePose> spiral_poses(int n_actors, int n_centimetres_moved) {
    constexpr double kGoldenAngle_rad = 2.39996323;
    std::vector<InstancePose> placed{InstancePose{}};  // the background
    for (int i = 0; i < n_actors; ++i) {
        const double radius_m = 8.0 + 3.0 * std::sqrt(double(i)), azimuth_rad = kGoldenAngle_rad * i;
        placed.push_back({Pose{{1.0, 0.0, 0.0, 0.0},
                               {radius_m * std::cos(azimuth_rad) + 0.01 * n_centimetres_moved,
                                radius_m * std::sin(azimuth_rad), 0.0}}});
    }
    return placed;
}

/// Returns the input of a benchmark: a scene with actors, and the rays of one scan from
/// the origin of the world frame.
/// @param copy_shared_models  if true, each actor has a copy of the surfels
DevCase make_actor_case(int n_actors, bool copy_shared_models) {
    DevCase bench;
    bench.name = fmt::format("{} actors", n_actors);
    bench.scene = make_actor_scene(n_actors, copy_shared_models);
    bench.placed = spiral_poses(n_actors, 0);
    const RayTable table = make_street_rays(kImageRows, kImageColumns, kHighestBeam_deg, kLowestBeam_deg);
    bench.rows = table.rows;
    bench.columns = table.columns;
    bench.rays = {.origin = to_vector(table.origin), .direction = to_vector(table.direction)};
    bench.config = make_preset("paper");
    // The intensity of a surfel depends on the direction from which it is seen. A surfel
    // of one actor gets one value per scan, a shared surfel gets one value per ray.
    bench.config.image.sh_direction = copy_shared_models ? ShDirection::surfel : ShDirection::ray;
    return bench;
}

/// Measures the time to build the trees of a scene, and to move all actors by one step.
void measure_updates(Device& device, const DevCase& setup, int n_repetitions, ActorBenchTimes& actor_times) {
    constexpr int kWarmUpSteps = 3;  // not measured, because they allocate memory
    DeviceScene on_device(device, setup.scene);
    AccelerationStructure accel(device, on_device, {.proxy = setup.proxy});
    Stream stream(device, false);
    on_device.activate(stream, setup.config.image, glm::vec3(0.0f));
    stream.submit_and_wait();

    // The first refit builds all trees.
    Clock::time_point start = Clock::now();
    accel.record_refit(stream, on_device);
    stream.submit_and_wait();
    actor_times.build_ms = ms_since(start);

    const std::uint64_t builds_before = accel.n_updates();
    std::vector<double> samples;
    for (int step = 1; step <= kWarmUpSteps + n_repetitions; ++step) {
        check_interrupt();
        const std::vector<InstancePose> placed = spiral_poses(actor_times.n_actors, step);
        start = Clock::now();
        on_device.stage_poses(stream, placed);
        accel.record_top_level(stream, on_device);
        stream.submit_and_wait();
        if (step > kWarmUpSteps) samples.push_back(ms_since(start));
    }
    actor_times.move_ms = percentiles_of(samples);
    actor_times.builds = accel.n_updates() - builds_before;
}

TimePercentiles iteration_times(const BenchResult& result) {
    return std::ranges::find(result.phases, "iteration_wall", &KernelBenchTime::name)->ms;
}

std::string median_ms(const TimePercentiles& percentiles_ms) {
    return fmt::format("{:.2f}", percentiles_ms.median);
}

}  // namespace

std::uint64_t ActorBenchTimes::n_surfels() const {
    return std::uint64_t(copy_shared_models ? n_actors : 1) * kActorSurfels;
}

ActorBenchTimes measure_actors(Device& device, int n_actors, bool copy_shared_models,
                               const BenchSettings& settings) {
    const DevCase bench = make_actor_case(n_actors, copy_shared_models);
    ActorBenchTimes times{.n_actors = n_actors, .copy_shared_models = copy_shared_models};
    measure_updates(device, bench, settings.repeat, times);
    // A scan needs only the forward pass, a training step also the backward pass.
    BenchSettings scan = settings, step = settings;
    scan.backward = false;
    step.backward = true;
    times.scan_ms = iteration_times(run_benchmark(device, bench, scan));
    const BenchResult trained = run_benchmark(device, bench, step);
    times.step_ms = iteration_times(trained);
    times.memory =
        trained.memory.scene + trained.memory.accel + trained.memory.training + trained.memory.rays;
    return times;
}

std::string format_actors(const std::vector<ActorBenchTimes>& times) {
    TableRows rows{{"actors", "models", "surfels", "build ms", "move ms", "scan ms", "step ms", "memory MiB",
                    "actor trees rebuilt"}};
    for (const ActorBenchTimes& t : times)
        rows.push_back({fmt::format("{}", t.n_actors), t.copy_shared_models ? "separate" : "shared",
                        fmt::format("{}", t.n_surfels()), fmt::format("{:.2f}", t.build_ms),
                        median_ms(t.move_ms), median_ms(t.scan_ms), median_ms(t.step_ms),
                        fmt::format("{:.1f}", double(t.memory) / double(1 << 20)),
                        fmt::format("{}", t.builds)});
    return format_table(rows);
}

}  // namespace relidar::cli
