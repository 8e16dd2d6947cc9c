// SPDX-License-Identifier: Apache-2.0
#include "bench_actors.hpp"

#include <chrono>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "console.hpp"
#include "interrupt.hpp"
#include <relidar/stages/accel.hpp>
#include <relidar/measure/scene.hpp>
#include <relidar/stages/scene.hpp>

namespace relidar::cli {
namespace {

using Clock = std::chrono::steady_clock;
double ms_since(Clock::time_point start) { return std::chrono::duration<double, std::milli>(Clock::now() - start).count(); }

Scene scene_of_actors(int n_actors) {
    Surfels actor = make_benchmark_street(kActorSurfels);
    actor = actor.permuted(kd_order(actor.mean));
    Scene scene = make_background_scene({});
    for (int i = 0; i < n_actors; ++i) {
        scene.instances.push_back({static_cast<std::uint32_t>(scene.models.size()), fmt::format("{}", i)});
        scene.models.push_back({fmt::format("{}", i), static_cast<std::uint32_t>(scene.surfels.size()), kActorSurfels});
        scene.surfels.append(actor);
    }
    return scene;
}

/// All actors a metre further, at each step.
std::vector<InstancePose> poses_at(int n_actors, int step) {
    std::vector<InstancePose> placed{InstancePose{}};
    for (int i = 0; i < n_actors; ++i) placed.push_back({Pose{{1.0, 0.0, 0.0, 0.0}, {double(step), 5.0 * i, 0.0}}});
    return placed;
}

}  // namespace

ActorMoves measure_moves(Device& device, int n_actors, int repeat) {
    constexpr int kWarmUp = 3;
    const Scene scene = scene_of_actors(n_actors);
    DeviceScene on_device(device, scene);
    Accel accel(device, on_device, {});
    Stream stream(device, false);
    ActorMoves result;
    result.n_actors = n_actors;
    on_device.activate(stream, {}, glm::vec3(0.0f));
    stream.finish();
    Clock::time_point start = Clock::now();
    accel.update(stream, on_device);
    stream.finish();
    result.build_ms = ms_since(start);
    const std::uint64_t builds_before = accel.updates();
    std::vector<double> samples;
    for (int step = 1; step <= kWarmUp + repeat; ++step) {
        stop_if_interrupted();
        const std::vector<InstancePose> placed = poses_at(n_actors, step);
        start = Clock::now();
        on_device.place(stream, placed);
        accel.move(stream, on_device);
        stream.finish();
        if (step > kWarmUp) samples.push_back(ms_since(start));
    }
    result.move_ms = spread_of(samples);
    result.builds = accel.updates() - builds_before;
    return result;
}

std::string moves_text(const std::vector<ActorMoves>& moves) {
    std::vector<std::vector<std::string>> rows{{"actors", "surfels", "build ms", "move p10 ms", "move median ms", "move p90 ms", "bottom levels rebuilt"}};
    for (const ActorMoves& m : moves)
        rows.push_back({fmt::format("{}", m.n_actors), fmt::format("{}", std::uint64_t(m.n_actors) * kActorSurfels), fmt::format("{:.2f}", m.build_ms), fmt::format("{:.3f}", m.move_ms.p10),
                        fmt::format("{:.3f}", m.move_ms.median), fmt::format("{:.3f}", m.move_ms.p90), fmt::format("{}", m.builds)});
    return table(rows);
}

std::string moves_json(const std::vector<ActorMoves>& moves, const Device& device, const std::string& command_line) {
    nlohmann::ordered_json json = {{"format", "relidar bench actors"}, {"version", 1}, {"relidar", RELIDAR_VERSION}, {"command", command_line}, {"device", device.info().name}, {"moves", nlohmann::ordered_json::array()}};
    for (const ActorMoves& m : moves)
        json["moves"].push_back({{"actors", m.n_actors}, {"surfels_each", kActorSurfels}, {"build_ms", m.build_ms}, {"move_ms", {{"p10", m.move_ms.p10}, {"median", m.move_ms.median}, {"p90", m.move_ms.p90}}}, {"bottom_levels_rebuilt", m.builds}});
    return json.dump(1) + "\n";
}

}  // namespace relidar::cli
