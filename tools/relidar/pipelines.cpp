// SPDX-License-Identifier: Apache-2.0
// relidar pipelines: compiles every pipeline of the program on a device and prints what the driver's compiler says of it.
#include <algorithm>
#include <filesystem>
#include <memory>
#include <set>

#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include "command.hpp"
#include "console.hpp"
#include <relidar/gpu.hpp>
#include <relidar/train.hpp>

namespace relidar::cli {
namespace {

struct Options {
    int device = -1;
    std::string traversal = "both";
    std::string kernel;
    bool tsv = false;
};

/// Pipelines of a device with one traversal; nothing where it cannot.
std::vector<PipelineStatistics> compiled(const Options& options, Traversal traversal) {
    Device device({.index = options.device, .traversal = traversal, .compile_only = true});
    Progress progress(false);
    compile_pipelines(device, [&](const std::string& what) { progress.show("compiling: " + what); });
    return device.pipelines();
}

/// Those of both traversals, each once.
std::vector<PipelineStatistics> all_compiled(const Options& options) {
    std::vector<PipelineStatistics> all;
    std::set<std::string> known;
    for (const auto& [name, traversal] : {std::pair{"software", Traversal::software}, std::pair{"ray_query", Traversal::ray_query}}) {
        if (options.traversal != "both" && options.traversal != name) continue;
        const std::vector<DeviceInfo> devices = list_devices();
        const int index = std::max(options.device, 0);
        const bool has = std::size_t(index) >= devices.size() || (traversal == Traversal::software ? devices[std::size_t(index)].software : devices[std::size_t(index)].ray_query);
        if (options.traversal == "both" && !has) continue;
        for (PipelineStatistics& p : compiled(options, traversal)) {
            if (p.kernel.find(options.kernel) == std::string::npos) continue;
            if (known.insert(fmt::format("{} {} {}", p.kernel, p.constants, p.workgroup_size)).second) all.push_back(std::move(p));
        }
    }
    return all;
}

std::vector<std::string> statistic_names(const std::vector<PipelineStatistics>& pipelines) {
    std::set<std::string> names;
    for (const PipelineStatistics& p : pipelines)
        for (const auto& [name, value] : p.values) names.insert(name);
    return {names.begin(), names.end()};
}

std::vector<std::vector<std::string>> rows_of(const std::vector<PipelineStatistics>& pipelines) {
    const std::vector<std::string> names = statistic_names(pipelines);
    std::vector<std::vector<std::string>> rows{{"kernel", "constants", "workgroup", "subgroup", "failure"}};
    rows[0].insert(rows[0].end(), names.begin(), names.end());
    for (const PipelineStatistics& p : pipelines) {
        std::vector<std::string> row{p.kernel, p.constants, fmt::format("{}", p.workgroup_size), fmt::format("{}", p.subgroup_size), p.failure};
        for (const std::string& name : names) row.push_back(p.values.count(name) ? fmt::format("{}", p.values.at(name)) : "");
        rows.push_back(row);
    }
    return rows;
}

void run(const Options& options) {
    const std::vector<PipelineStatistics> pipelines = all_compiled(options);
    if (!options.tsv) {
        print(table(rows_of(pipelines)));
        return;
    }
    for (const std::vector<std::string>& row : rows_of(pipelines)) print(fmt::format("{}\n", fmt::join(row, "\t")));
}

}  // namespace

void add_pipelines(CLI::App& app, Call& call) {
    CLI::App* command = app.add_subcommand("pipelines", "compile every kernel as the program uses it and print what the device's compiler says: registers, spills, waves");
    const auto options = std::make_shared<Options>();
    command->add_option("--device", options->device, "number of `relidar devices`");
    command->add_option("--traversal", options->traversal, "software, ray_query or both")->check(CLI::IsMember({"software", "ray_query", "both"}));
    command->add_option("--kernel", options->kernel, "only kernels whose name contains this");
    command->add_flag("--tsv", options->tsv, "one line a pipeline, columns separated by tabs");
    command->footer("Nothing is run, so a driver without hardware will do (tools/dev/gpu_report).\nExample: relidar pipelines --kernel trace");
    command->callback([&call, options] { call.run = [options] { run(*options); }; });
}

}  // namespace relidar::cli
