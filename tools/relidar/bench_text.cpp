// SPDX-License-Identifier: Apache-2.0
#include "bench_text.hpp"

#include <algorithm>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "bench_case.hpp"
#include "bench_measure.hpp"
#include "console.hpp"
#include <relidar/gpu.hpp>

namespace relidar::cli {
namespace {

using Json = nlohmann::ordered_json;

std::string milliseconds(double ms) { return fmt::format("{:.{}f}", ms, ms < 1.0 ? 4 : ms < 100.0 ? 3 : 1); }

std::string phase_text(const std::string& phase, bool training) {
    if (phase == "iteration") return training ? "whole iteration" : "whole frame";
    if (phase == "iteration_wall") return training ? "whole iteration, wall time" : "whole frame, wall time";
    if (phase == "rebuild") return "rebuild";
    return "move of one instance";
}

std::string traversal_of(const Device& device) { return device.traversal() == Traversal::software ? "software" : "ray_query"; }
/// What there is to choose about a traversal.
std::string search_of(const Device& device, const BenchCase& bench, const BenchResult& result) {
    return device.traversal() == Traversal::software ? "walk " + bench.config.trace.walk : "proxy " + result.proxy;
}
std::string sh_of(const BenchCase& bench) { return bench.config.image.sh_direction == ShDirection::ray ? "ray" : "surfel"; }
std::uint64_t surfel_bytes(const BenchMemory& m) { return m.scene + m.accel + m.training; }

double each(std::uint64_t n_bytes, std::size_t n) { return static_cast<double>(n_bytes) / static_cast<double>(std::max<std::size_t>(n, 1)); }

std::string memory_text(const BenchMemory& m, std::size_t n_surfels, std::size_t n_rays) {
    return fmt::format("memory    {} at peak; {:.0f} bytes a surfel (scene {:.0f}, acceleration structure {:.0f}, gradients and moments {:.0f}), {:.0f} bytes a ray\n", byte_size(m.peak),
                       each(surfel_bytes(m), n_surfels), each(m.scene, n_surfels), each(m.accel, n_surfels), each(m.training, n_surfels), each(m.rays, n_rays));
}

Json spreads(const std::vector<BenchRow>& rows) {
    Json json = Json::object();
    for (const BenchRow& row : rows) json[row.name] = {{"p10", row.ms.p10}, {"median", row.ms.median}, {"p90", row.ms.p90}};
    return json;
}

Json memory_json(const BenchMemory& m, std::size_t n_surfels, std::size_t n_rays) {
    return {{"peak_bytes", m.peak},
            {"scene_bytes", m.scene},
            {"accel_bytes", m.accel},
            {"training_bytes", m.training},
            {"ray_bytes", m.rays},
            {"bytes_per_surfel", each(surfel_bytes(m), n_surfels)},
            {"accel_bytes_per_surfel", each(m.accel, n_surfels)},
            {"bytes_per_ray", each(m.rays, n_rays)}};
}

}  // namespace

std::string bench_text(const BenchCase& bench, const BenchResult& result, const Device& device) {
    std::string text = fmt::format("case      {}: {} surfels, {} rays ({} x {})\n", bench.name, bench.scene.surfels.size(), bench.rays.size(), bench.rows, bench.columns);
    text += fmt::format("device    {}\nsettings  traversal {}, {}, chunk {}, harmonics along the {}\n", device.info().name, traversal_of(device), search_of(device, bench, result), bench.config.trace.chunk,
                        sh_of(bench));
    if (!result.device_clock) text += "note      the device has no timestamps: wall time of the forward pass alone, waits included\n";
    std::vector<std::vector<std::string>> rows{{"kernel", "p10 ms", "median ms", "p90 ms"}};
    const auto add = [&](const std::string& name, const Spread& ms) { rows.push_back({name, milliseconds(ms.p10), milliseconds(ms.median), milliseconds(ms.p90)}); };
    for (const BenchRow& row : result.kernels) add(row.name, row.ms);
    for (const BenchRow& row : result.phases) add(phase_text(row.name, result.backward_mrays_per_s.has_value()), row.ms);
    text += "\n" + table(rows) + fmt::format("\nforward   {:.3f} Mrays/s, {:.2f} blended hits a ray\n", result.forward_mrays_per_s, result.hits_per_ray);
    if (result.visits) text += fmt::format("visits    {:.1f} nodes and {:.1f} surfels tested a ray\n", result.visits->nodes, result.visits->surfels);
    if (result.backward_mrays_per_s) text += fmt::format("backward  {:.3f} Mrays/s\n", *result.backward_mrays_per_s);
    return text + memory_text(result.memory, bench.scene.surfels.size(), bench.rays.size());
}

std::string bench_json(const BenchCase& bench, const BenchSettings& settings, const BenchResult& result, const Device& device, const std::string& command_line) {
    const DeviceInfo& info = device.info();
    Json json = {{"format", "relidar bench"},
                 {"version", 1},
                 {"relidar", RELIDAR_VERSION},
                 {"command", command_line},
                 {"device", {{"name", info.name}, {"type", info.type}, {"driver", info.driver}, {"float_atomics", info.float_atomics}, {"traversal", traversal_of(device)}}},
                 {"case", {{"name", bench.name}, {"surfels", bench.scene.surfels.size()}, {"instances", bench.scene.instances.size()}, {"rays", bench.rays.size()},
                           {"rows", bench.rows}, {"columns", bench.columns}, {"chunk", bench.config.trace.chunk}, {"proxy", result.proxy}, {"walk", bench.config.trace.walk}, {"sh", sh_of(bench)},
                           {"sh_degree", bench.config.image.sh_degree}}},
                 {"repetitions", settings.repeat},
                 {"clock", result.device_clock ? "device timestamps, all launches of a kernel in a repetition" : "wall time of the forward pass, waits included"},
                 {"kernels_ms", spreads(result.kernels)},
                 {"phases_ms", spreads(result.phases)},
                 {"forward_mrays_per_s", result.forward_mrays_per_s},
                 {"backward_mrays_per_s", nullptr},
                 {"hits_per_ray", result.hits_per_ray},
                 {"nodes_per_ray", nullptr},
                 {"surfels_tested_per_ray", nullptr},
                 {"memory", memory_json(result.memory, bench.scene.surfels.size(), bench.rays.size())}};
    if (result.backward_mrays_per_s) json["backward_mrays_per_s"] = *result.backward_mrays_per_s;
    if (result.visits) json["nodes_per_ray"] = result.visits->nodes, json["surfels_tested_per_ray"] = result.visits->surfels;
    return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace relidar::cli
