// SPDX-License-Identifier: Apache-2.0
#include "steps.hpp"

#include <algorithm>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/score/evaluation.hpp>
#include "interrupt.hpp"
#include "options.hpp"

namespace relidar::cli {

StepTimes measure_steps(Device& device, const std::string& folder, int n_steps, bool quiet) {
    Run run = load_run(folder);
    attach_scans(run, run.split.train, load_dataset(run.config, quiet));
    StepTimes times = time_steps(device, run, n_steps, interrupted);
    stop_if_interrupted();
    return times;
}

std::string steps_text(const StepTimes& t, const Device& device) {
    using Row = std::pair<std::string, StepTimes::Kernel>;
    std::vector<Row> rows(t.kernels.begin(), t.kernels.end());
    std::sort(rows.begin(), rows.end(), [](const Row& a, const Row& b) { return a.second.ms > b.second.ms; });
    std::string text = fmt::format(
        "{}\n{} surfels, {} rays a step, {} hits kept a ray; means of {} steps\n\n{:<28}{:>9}{:>10}{:>8}\n",
        device.info().name, t.surfels, t.rays, t.kept_hits, t.n_steps, "kernel", "launches", "ms", "share");
    const auto row = [&](const std::string& name, const std::string& launches, double ms) {
        text += fmt::format("{:<28}{:>9}{:>10.3f}{:>7.1f}%\n", name, launches, ms, 100.0 * ms / t.wall_ms);
    };
    for (const auto& [name, kernel] : rows) row(name, fmt::format("{:.3g}", kernel.launches), kernel.ms);
    if (rows.empty()) text += "the device has no timestamps\n";
    else row("between kernels", "", t.between_ms());
    row("step, wall time", "", t.wall_ms);
    return text + fmt::format("{:.2f} steps/s\n", 1e3 / t.wall_ms);
}

std::string steps_json(const StepTimes& t, const Device& device, const std::string& command_line) {
    nlohmann::ordered_json kernels = nlohmann::ordered_json::object();
    for (const auto& [name, kernel] : t.kernels)
        kernels[name] = {{"launches", kernel.launches}, {"ms", kernel.ms}};
    const nlohmann::ordered_json json = {{"format", "relidar-dev bench steps"},
                                         {"version", 1},
                                         {"relidar", RELIDAR_VERSION},
                                         {"command", command_line},
                                         {"device", device.info().name},
                                         {"steps", t.n_steps},
                                         {"surfels", t.surfels},
                                         {"rays", t.rays},
                                         {"kept_hits", t.kept_hits},
                                         {"wall_ms", t.wall_ms},
                                         {"between_ms", t.between_ms()},
                                         {"kernels", kernels}};
    return json.dump(1) + "\n";
}

}  // namespace relidar::cli
