// SPDX-License-Identifier: Apache-2.0
#include "measure.hpp"

#include <algorithm>
#include <array>
#include <map>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/gpu/device.hpp>
#include "console.hpp"
#include "dev_case.hpp"

namespace relidar::cli {
namespace {

using Json = nlohmann::ordered_json;

std::string format_ms(double ms) {
    int n_decimals = 1;
    if (ms < 1.0) n_decimals = 4;
    else if (ms < 100.0) n_decimals = 3;
    return fmt::format("{:.{}f}", ms, n_decimals);
}

/// Returns the title of a phase of BenchResult::phases.
std::string phase_title(const std::string& phase_id, bool includes_training) {
    const std::string repetition = includes_training ? "complete iteration" : "complete frame";
    if (phase_id == "iteration") return repetition;
    if (phase_id == "iteration_wall") return repetition + ", wall time";
    return phase_id == "rebuild" ? "rebuild of the tree" : "move of one instance";
}

std::string mode_name(const DevCase& setup) {
    return std::array{"automatic", "lane", "subgroup"}[std::size_t(setup.traversal_mode)];
}

std::string backend_name(const Device& device) {
    return device.backend() == RayTracingBackend::software ? "software" : "ray_query";
}
std::string sh_direction_name(const DevCase& setup) {
    return setup.config.image.sh_direction == ShDirection::ray ? "ray" : "surfel";
}
std::string summation_method(const BenchResult& result) {
    if (!result.sizes.training) return "none";
    return result.sizes.gather ? "gather" : "atomics";
}
double bytes_per_item(std::uint64_t n_bytes, std::size_t count) {
    return double(n_bytes) / double(std::max<std::size_t>(count, 1));
}

std::string format_memory(const BenchMemory& memory, std::size_t n_surfels, std::size_t n_rays) {
    return fmt::format(
        "memory    {} at peak; {:.0f} bytes per surfel (scene {:.0f}, acceleration structure {:.0f}, "
        "gradients and moments {:.0f}), {:.0f} bytes per ray\n",
        format_bytes(memory.peak), bytes_per_item(surfel_bytes(memory), n_surfels),
        bytes_per_item(memory.scene, n_surfels), bytes_per_item(memory.accel, n_surfels),
        bytes_per_item(memory.training, n_surfels), bytes_per_item(memory.rays, n_rays));
}

/// Returns a lower bound ("floor") for the time of each kernel, in milliseconds: the time
/// to copy the data that it must read and write. Also returns the sums of these bounds
/// for the phases "iteration" (on the device; "iteration_wall" is its time on the host)
/// and "rebuild" (of the acceleration structure). Empty if the copy speed is unknown.
std::map<std::string, double> lower_bounds_ms(const BenchResult& result) {
    std::map<std::string, double> floors;
    if (!result.copy_bytes_per_s) return floors;
    for (const auto& [kernel, bytes] : min_traffic_bytes(result.sizes))
        floors[kernel] = bytes / *result.copy_bytes_per_s * 1000.0;
    // An iteration refits the acceleration structure instead of building it.
    double iteration = 0.0;
    for (const auto& [kernel, ms] : floors) iteration += kernel == "accel/build" ? 0.0 : ms;
    floors["iteration"] = floors["iteration_wall"] = iteration;
    if (floors.contains("accel/build"))
        floors["rebuild"] = floors["diff/accel/proxies"] + floors["accel/build"];
    return floors;
}

std::string format_bounds(const BenchResult& result) {
    if (!result.copy_bytes_per_s)
        return "floors    unknown, because too little device memory is free to measure a copy\n";
    return fmt::format(
        "floors    minimum memory traffic at the speed of a copy ({:.1f} GB/s), without latency, divergence "
        "and arithmetic\n",
        *result.copy_bytes_per_s * 1e-9);
}

/// Returns the times of kernels or phases, each with its lower bound if it has one.
Json percentiles_json(const std::vector<KernelBenchTime>& rows,
                      const std::map<std::string, double>& min_times_ms) {
    Json json = Json::object();
    for (const KernelBenchTime& row : rows) {
        Json& entry = json[row.name] = {{"p10", row.ms.p10},
                                        {"median", row.ms.median},
                                        {"p90", row.ms.p90},
                                        {"floor", nullptr},
                                        {"median_over_floor", nullptr}};
        if (const auto floor = min_times_ms.find(row.name); floor != min_times_ms.end()) {
            entry["floor"] = floor->second;
            entry["median_over_floor"] = row.ms.median / floor->second;
        }
    }
    return json;
}

Json bounds_json(const BenchResult& result) {
    Json json = {{"copy_bytes_per_s", nullptr},
                 {"bytes", min_traffic_bytes(result.sizes)},
                 {"surfels_with_gradient", result.sizes.n_touched},
                 {"left_out", "latency, divergence, second loads of what a cache loses, arithmetic"}};
    if (result.copy_bytes_per_s) json["copy_bytes_per_s"] = *result.copy_bytes_per_s;
    return json;
}

/// Returns a table with the times of all kernels, followed by those of the phases. The
/// "floor" of a kernel is the time that it needs at least (lower_bounds_ms).
TableRows time_rows(const BenchResult& result) {
    TableRows rows{{"kernel", "p10 ms", "median ms", "p90 ms", "floor ms", "median / floor"}};
    const std::map<std::string, double> floors_ms = lower_bounds_ms(result);
    const auto add_row = [&](const std::string& title, const KernelBenchTime& time) {
        rows.push_back({title, format_ms(time.ms.p10), format_ms(time.ms.median), format_ms(time.ms.p90)});
        const auto floor = floors_ms.find(time.name);
        const bool has_floor = floor != floors_ms.end();
        rows.back().push_back(has_floor ? format_ms(floor->second) : "-");
        rows.back().push_back(has_floor ? fmt::format("{:.1f}", time.ms.median / floor->second) : "-");
    };
    for (const KernelBenchTime& kernel : result.kernels) add_row(kernel.name, kernel);
    const bool includes_training = result.backward_mrays_per_s.has_value();
    for (const KernelBenchTime& phase : result.phases)
        add_row(phase_title(phase.name, includes_training), phase);
    return rows;
}

/// Returns the device memory of each part in bytes, and its share per surfel or ray.
Json memory_json(const BenchMemory& memory, std::size_t n_surfels, std::size_t n_rays) {
    return {{"peak_bytes", memory.peak},
            {"scene_bytes", memory.scene},
            {"accel_bytes", memory.accel},
            {"training_bytes", memory.training},
            {"ray_bytes", memory.rays},
            {"bytes_per_surfel", bytes_per_item(surfel_bytes(memory), n_surfels)},
            {"accel_bytes_per_surfel", bytes_per_item(memory.accel, n_surfels)},
            {"bytes_per_ray", bytes_per_item(memory.rays, n_rays)}};
}

}  // namespace

std::string format_result(const DevCase& setup, const BenchResult& result, const Device& device) {
    const std::size_t n_surfels = setup.scene.surfels.size(), n_rays = setup.rays.size();
    const std::string traversal_variant = device.backend() == RayTracingBackend::software
                                              ? "walk " + mode_name(setup)
                                              : "proxy " + result.proxy;
    std::string text =
        fmt::format("case      {}: {} surfels, {} rays ({} x {})\n", setup.name, n_surfels, n_rays,
                    setup.rows, setup.columns) +
        fmt::format("device    {}\nsettings  traversal {}, {}, chunk {}, harmonics along the {}",
                    device.info().name, backend_name(device), traversal_variant, setup.config.trace.chunk,
                    sh_direction_name(setup));
    if (result.sizes.training)
        text += fmt::format(", {} hits stored per ray, gradients by {}", result.stored_hits_per_ray,
                            summation_method(result));
    text += "\n\n" + format_table(time_rows(result)) +
            fmt::format("\nforward   {:.3f} Mrays/s, {:.2f} blended hits per ray\n",
                        result.forward_mrays_per_s, result.hits_per_ray);
    if (result.visits)
        text += fmt::format("visits    {:.1f} nodes and {:.1f} surfels tested per ray\n",
                            result.visits->nodes, result.visits->surfels);
    if (result.backward_mrays_per_s)
        text += fmt::format("backward  {:.3f} Mrays/s\n", *result.backward_mrays_per_s);
    return text + format_bounds(result) + format_memory(result.memory, n_surfels, n_rays);
}

std::string result_json(const DevCase& setup, const BenchSettings& settings, const BenchResult& result,
                        const Device& device, const std::string& args) {
    const DeviceInfo& info = device.info();
    Json json = {{"format", "relidar-dev bench"},
                 {"version", 1},
                 {"relidar", RELIDAR_VERSION},
                 {"command", args},
                 {"device",
                  {{"name", info.name},
                   {"type", info.type},
                   {"driver", info.driver},
                   {"float_atomics", info.float_atomics},
                   {"traversal", backend_name(device)}}},
                 {"case",
                  {{"name", setup.name},
                   {"surfels", setup.scene.surfels.size()},
                   {"instances", setup.scene.instances.size()},
                   {"rays", setup.rays.size()},
                   {"rows", setup.rows},
                   {"columns", setup.columns},
                   {"chunk", setup.config.trace.chunk},
                   {"proxy", result.proxy},
                   {"walk", mode_name(setup)},
                   {"sh", sh_direction_name(setup)},
                   {"sh_degree", setup.config.image.sh_degree},
                   {"keep_hits", result.stored_hits_per_ray},
                   {"reduction", summation_method(result)}}},
                 {"repetitions", settings.repeat},
                 {"clock", "device timestamps, all launches of a kernel in a repetition"},
                 {"kernels_ms", percentiles_json(result.kernels, lower_bounds_ms(result))},
                 {"phases_ms", percentiles_json(result.phases, lower_bounds_ms(result))},
                 {"floor", bounds_json(result)},
                 {"forward_mrays_per_s", result.forward_mrays_per_s},
                 {"backward_mrays_per_s", nullptr},
                 {"hits_per_ray", result.hits_per_ray},
                 {"nodes_per_ray", nullptr},
                 {"surfels_tested_per_ray", nullptr},
                 {"memory", memory_json(result.memory, setup.scene.surfels.size(), setup.rays.size())}};
    if (result.backward_mrays_per_s) json["backward_mrays_per_s"] = *result.backward_mrays_per_s;
    if (result.visits) {
        json["nodes_per_ray"] = result.visits->nodes;
        json["surfels_tested_per_ray"] = result.visits->surfels;
    }
    return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace relidar::cli
