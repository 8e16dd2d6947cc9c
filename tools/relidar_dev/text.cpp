// SPDX-License-Identifier: Apache-2.0
#include "text.hpp"

#include <algorithm>
#include <map>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/gpu/device.hpp>
#include "console.hpp"
#include "dev_case.hpp"
#include "measure.hpp"

namespace relidar::cli {
namespace {

using Json = nlohmann::ordered_json;

std::string format_milliseconds(double ms) {
    return fmt::format("{:.{}f}", ms, ms < 1.0 ? 4 : ms < 100.0 ? 3 : 1);
}

std::string format_phase(const std::string& phase, bool training) {
    if (phase == "iteration") return training ? "whole iteration" : "whole frame";
    if (phase == "iteration_wall") return training ? "whole iteration, wall time" : "whole frame, wall time";
    if (phase == "rebuild") return "rebuild";
    return "move of one instance";
}

std::string get_traversal_mode_name(const DevCase& bench) {
    return bench.walk == Walk::lane ? "lane" : bench.walk == Walk::subgroup ? "subgroup" : "automatic";
}

std::string get_traversal_text(const Device& device) {
    return device.traversal() == Traversal::software ? "software" : "ray_query";
}
/// Returns a text that names the selected ray traversal and its variant.
std::string describe_search(const Device& device, const DevCase& bench, const BenchResult& result) {
    return device.traversal() == Traversal::software ? "walk " + get_traversal_mode_name(bench)
                                                     : "proxy " + result.proxy;
}
std::string describe_sh(const DevCase& bench) {
    return bench.config.image.sh_direction == ShDirection::ray ? "ray" : "surfel";
}
std::string describe_reduction(const BenchResult& result) {
    return !result.sizes.training ? "none" : result.sizes.gather ? "gather" : "atomics";
}
std::uint64_t count_surfel_bytes(const BenchMemory& memory) {
    return memory.scene + memory.accel + memory.training;
}

double compute_bytes_per_item(std::uint64_t n_bytes, std::size_t count) {
    return static_cast<double>(n_bytes) / static_cast<double>(std::max<std::size_t>(count, 1));
}

std::string format_memory(const BenchMemory& memory, std::size_t n_surfels, std::size_t n_rays) {
    return fmt::format(
        "memory    {} at peak; {:.0f} bytes a surfel (scene {:.0f}, acceleration structure {:.0f}, gradients "
        "and moments {:.0f}), {:.0f} "
        "bytes a ray\n",
        format_byte_size(memory.peak), compute_bytes_per_item(count_surfel_bytes(memory), n_surfels),
        compute_bytes_per_item(memory.scene, n_surfels), compute_bytes_per_item(memory.accel, n_surfels),
        compute_bytes_per_item(memory.training, n_surfels), compute_bytes_per_item(memory.rays, n_rays));
}

/// Returns a lower bound for the time of each kernel, in milliseconds. The bound of a
/// phase (a group of kernels) is the sum of their bounds.
std::map<std::string, double> compute_floors_ms(const BenchResult& result) {
    std::map<std::string, double> floors;
    if (!result.copy_bytes_per_s) return floors;
    for (const auto& [kernel, bytes] : compute_floor_bytes(result.sizes))
        floors[kernel] = bytes / *result.copy_bytes_per_s * 1000.0;
    double iteration = 0.0;
    for (const auto& [kernel, ms] : floors) iteration += kernel == "accel/build" ? 0.0 : ms;
    floors["iteration"] = floors["iteration_wall"] = iteration;
    if (floors.contains("accel/build"))
        floors["rebuild"] = floors["diff/accel/proxies"] + floors["accel/build"];
    return floors;
}

std::string format_floor(const BenchResult& result) {
    if (!result.copy_bytes_per_s) return "floors    none: no room for a copy to compare with\n";
    std::string text = fmt::format(
        "floors    bytes that must move once, at the {:.1f} GB/s of a copy; latency, divergence and "
        "arithmetic are left out\n",
        *result.copy_bytes_per_s * 1e-9);
    const std::map<std::string, double> cached = compute_cache_bytes(result.sizes);
    for (const auto& [kernel, bytes] : cached)
        text += fmt::format("caches    {} asks for {:.3f} GB, {} ms at the copy's rate\n", kernel,
                            bytes * 1e-9, format_milliseconds(bytes / *result.copy_bytes_per_s * 1000.0));
    if (!cached.empty())
        text += fmt::format("search    about {:.3f} G operations in {}\n",
                            count_search_operations(result.sizes) * 1e-9,
                            result.sizes.lists ? "diff/forward/append" : "diff/forward/trace");
    return text;
}

Json make_spreads_json(const std::vector<BenchRow>& rows, const std::map<std::string, double>& floors) {
    Json json = Json::object();
    for (const BenchRow& row : rows) {
        Json& entry = json[row.name] = {{"p10", row.ms.p10},
                                        {"median", row.ms.median},
                                        {"p90", row.ms.p90},
                                        {"floor", nullptr},
                                        {"median_over_floor", nullptr}};
        if (const auto floor = floors.find(row.name); floor != floors.end())
            entry["floor"] = floor->second, entry["median_over_floor"] = row.ms.median / floor->second;
    }
    return json;
}

Json make_floor_json(const BenchResult& result) {
    Json json = {{"copy_bytes_per_s", nullptr},
                 {"bytes", compute_floor_bytes(result.sizes)},
                 {"cache_bytes", compute_cache_bytes(result.sizes)},
                 {"search_operations", count_search_operations(result.sizes)},
                 {"surfels_with_gradient", result.sizes.n_touched},
                 {"left_out", "latency, divergence, second loads of what a cache loses, arithmetic"}};
    if (result.copy_bytes_per_s) json["copy_bytes_per_s"] = *result.copy_bytes_per_s;
    return json;
}

Json make_memory_json(const BenchMemory& memory, std::size_t n_surfels, std::size_t n_rays) {
    return {{"peak_bytes", memory.peak},
            {"scene_bytes", memory.scene},
            {"accel_bytes", memory.accel},
            {"training_bytes", memory.training},
            {"ray_bytes", memory.rays},
            {"bytes_per_surfel", compute_bytes_per_item(count_surfel_bytes(memory), n_surfels)},
            {"accel_bytes_per_surfel", compute_bytes_per_item(memory.accel, n_surfels)},
            {"bytes_per_ray", compute_bytes_per_item(memory.rays, n_rays)}};
}

}  // namespace

std::string format_bench(const DevCase& bench, const BenchResult& result, const Device& device) {
    std::string text = fmt::format("case      {}: {} surfels, {} rays ({} x {})\n", bench.name,
                                   bench.scene.surfels.size(), bench.rays.size(), bench.rows, bench.columns);
    text += fmt::format("device    {}\nsettings  traversal {}, {}, chunk {}, harmonics along the {}",
                        device.info().name, get_traversal_text(device),
                        describe_search(device, bench, result), bench.config.trace.chunk, describe_sh(bench));
    text += result.sizes.training ? fmt::format(", {} hits kept a ray, gradients by {}\n", result.kept_hits,
                                                describe_reduction(result))
                                  : "\n";
    if (!result.device_clock)
        text +=
            "note      the device has no timestamps: wall time of the forward pass alone, waits included\n";
    std::vector<std::vector<std::string>> rows{
        {"kernel", "p10 ms", "median ms", "p90 ms", "floor ms", "median / floor"}};
    const std::map<std::string, double> floors = compute_floors_ms(result);
    const auto add = [&](const BenchRow& row, const std::string& name) {
        const auto floor = floors.find(row.name);
        const bool known = floor != floors.end();
        rows.push_back({name, format_milliseconds(row.ms.p10), format_milliseconds(row.ms.median),
                        format_milliseconds(row.ms.p90), known ? format_milliseconds(floor->second) : "-",
                        known ? fmt::format("{:.1f}", row.ms.median / floor->second) : "-"});
    };
    for (const BenchRow& row : result.kernels) add(row, row.name);
    for (const BenchRow& row : result.phases)
        add(row, format_phase(row.name, result.backward_mrays_per_s.has_value()));
    text += "\n" + format_table(rows) +
            fmt::format("\nforward   {:.3f} Mrays/s, {:.2f} blended hits a ray\n", result.forward_mrays_per_s,
                        result.hits_per_ray);
    if (result.visits)
        text += fmt::format("visits    {:.1f} nodes and {:.1f} surfels tested a ray\n", result.visits->nodes,
                            result.visits->surfels);
    if (result.backward_mrays_per_s)
        text += fmt::format("backward  {:.3f} Mrays/s\n", *result.backward_mrays_per_s);
    return text + format_floor(result) +
           format_memory(result.memory, bench.scene.surfels.size(), bench.rays.size());
}

std::string make_bench_json(const DevCase& bench, const BenchSettings& settings, const BenchResult& result,
                            const Device& device, const std::string& command_line) {
    const DeviceInfo& info = device.info();
    Json json = {{"format", "relidar-dev bench"},
                 {"version", 1},
                 {"relidar", RELIDAR_VERSION},
                 {"command", command_line},
                 {"device",
                  {{"name", info.name},
                   {"type", info.type},
                   {"driver", info.driver},
                   {"float_atomics", info.float_atomics},
                   {"traversal", get_traversal_text(device)}}},
                 {"case",
                  {{"name", bench.name},
                   {"surfels", bench.scene.surfels.size()},
                   {"instances", bench.scene.instances.size()},
                   {"rays", bench.rays.size()},
                   {"rows", bench.rows},
                   {"columns", bench.columns},
                   {"chunk", bench.config.trace.chunk},
                   {"proxy", result.proxy},
                   {"walk", get_traversal_mode_name(bench)},
                   {"sh", describe_sh(bench)},
                   {"sh_degree", bench.config.image.sh_degree},
                   {"keep_hits", result.kept_hits},
                   {"reduction", describe_reduction(result)}}},
                 {"repetitions", settings.repeat},
                 {"clock", result.device_clock ? "device timestamps, all launches of a kernel in a repetition"
                                               : "wall time of the forward pass, waits included"},
                 {"kernels_ms", make_spreads_json(result.kernels, compute_floors_ms(result))},
                 {"phases_ms", make_spreads_json(result.phases, compute_floors_ms(result))},
                 {"floor", make_floor_json(result)},
                 {"forward_mrays_per_s", result.forward_mrays_per_s},
                 {"backward_mrays_per_s", nullptr},
                 {"hits_per_ray", result.hits_per_ray},
                 {"nodes_per_ray", nullptr},
                 {"surfels_tested_per_ray", nullptr},
                 {"memory", make_memory_json(result.memory, bench.scene.surfels.size(), bench.rays.size())}};
    if (result.backward_mrays_per_s) json["backward_mrays_per_s"] = *result.backward_mrays_per_s;
    if (result.visits)
        json["nodes_per_ray"] = result.visits->nodes, json["surfels_tested_per_ray"] = result.visits->surfels;
    return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace relidar::cli
