// SPDX-License-Identifier: Apache-2.0
// Implements the command `relidar-dev pipelines`. Compiles all compute pipelines of the
// program on a device, and prints the statistics of the driver's compiler.
#include <memory>
#include <set>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/gpu/device.hpp>
#include "commands.hpp"
#include "console.hpp"
#include "options.hpp"
#include "train/compile_pipelines.hpp"

namespace relidar::cli {
namespace {

struct PipelinesOptions {
    int device = -1;
    std::string traversal = "both";
    std::string kernel;
    bool tsv = false;
};

std::vector<PipelineStatistics> compile_backend(int device_index, RayTracingBackend backend) {
    Device device({.index = device_index, .traversal = backend, .compile_only = true});
    TerminalProgress progress(false);
    compile_pipelines(device, [&](const std::string& text) { progress.show_text("compiling: " + text); });
    return device.statistics();
}

/// Compiles the pipelines for the requested kind of ray traversal. "both" means all kinds
/// that the device supports. Each pipeline is listed only once.
std::vector<PipelineStatistics> compile_requested(const PipelinesOptions& options) {
    const DeviceInfo info = Device(apply_environment({.index = options.device, .compile_only = true})).info();
    std::vector<PipelineStatistics> all;
    std::set<std::string> known_pipelines;
    const auto add_backend = [&](const char* name, RayTracingBackend backend, bool is_supported) {
        const bool is_requested = options.traversal == name || (options.traversal == "both" && is_supported);
        if (!is_requested) return;
        for (PipelineStatistics& p : compile_backend(info.index, backend)) {
            const bool is_selected = p.kernel.find(options.kernel) != std::string::npos;
            // Kernels that trace no rays are the same for both backends.
            const std::string key = fmt::format("{} {} {}", p.kernel, p.constants, p.workgroup_size);
            if (is_selected && known_pipelines.insert(key).second) all.push_back(std::move(p));
        }
    };
    add_backend("software", RayTracingBackend::software, info.software);
    add_backend("ray_query", RayTracingBackend::ray_query, info.ray_query);
    return all;
}

/// Returns a table with a row for each pipeline and a column for each statistic that any
/// pipeline has. The names of the statistics depend on the driver.
TableRows statistic_rows(const std::vector<PipelineStatistics>& pipelines) {
    std::set<std::string> statistics;
    for (const PipelineStatistics& p : pipelines)
        for (const auto& [name, value] : p.values) statistics.insert(name);
    TableRows rows{{"kernel", "constants", "workgroup", "subgroup", "failure"}};
    rows[0].insert(rows[0].end(), statistics.begin(), statistics.end());
    for (const PipelineStatistics& p : pipelines) {
        std::vector<std::string> row{p.kernel, p.constants, fmt::format("{}", p.workgroup_size),
                                     fmt::format("{}", p.subgroup_size), p.failure};
        for (const std::string& name : statistics)
            row.push_back(p.values.contains(name) ? fmt::format("{}", p.values.at(name)) : "");
        rows.push_back(row);
    }
    return rows;
}

void print_statistics(const PipelinesOptions& options) {
    const std::vector<PipelineStatistics> pipelines = compile_requested(options);
    if (!options.tsv) {
        print(format_table(statistic_rows(pipelines)));
        return;
    }
    for (const std::vector<std::string>& row : statistic_rows(pipelines))
        print(fmt::format("{}\n", fmt::join(row, "\t")));
}

}  // namespace

/// Adds the command `relidar-dev pipelines` and its options to the parser.
void add_pipelines(CLI::App& app, ParsedCommand& selected_command) {
    CLI::App* command = app.add_subcommand("pipelines",
                                           "compile each kernel as relidar uses it and print statistics from "
                                           "the compiler of the driver: registers, spills, waves");
    const auto options = std::make_shared<PipelinesOptions>();
    command->add_option("--device", options->device, "number of the device in `relidar list devices`");
    command
        ->add_option("--traversal", options->traversal, "method to trace rays: software, ray_query or both")
        ->check(CLI::IsMember({"software", "ray_query", "both"}));
    command->add_option("--kernel", options->kernel, "only kernels whose name contains this text");
    command->add_flag("--tsv", options->tsv, "print one line per pipeline, with columns separated by tabs");
    command->footer(
        "No kernel runs, so a driver without hardware is sufficient (tools/dev/gpu_report).\nExample: "
        "relidar-dev pipelines --kernel trace");
    run_after_parsing(*command, selected_command, options, print_statistics);
}

}  // namespace relidar::cli
