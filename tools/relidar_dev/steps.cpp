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

TrainingStepTimes measure_steps(Device& device, const std::string& folder, int n_steps, bool quiet) {
    Run run = load_run(folder);
    copy_scans(run, run.split.train, load_dataset(run.config, quiet));
    TrainingStepTimes times = measure_steps(device, run, n_steps, is_interrupted);
    check_interrupt();
    return times;
}

std::string format_steps(const TrainingStepTimes& times, const Device& device) {
    using KernelTimeRow = std::pair<std::string, TrainingStepTimes::StepKernelTime>;
    std::vector<KernelTimeRow> rows(times.kernels.begin(), times.kernels.end());
    std::sort(rows.begin(), rows.end(), [](const KernelTimeRow& first, const KernelTimeRow& second) {
        return first.second.ms > second.second.ms;
    });
    std::string text = fmt::format(
        "{}\n{} surfels, {} rays per step, {} hits stored per ray; means of {} "
        "steps\n\n{:<28}{:>9}{:>10}{:>8}\n",
        device.info().name, times.surfels, times.rays, times.stored_hits_per_ray, times.n_steps, "kernel",
        "launches", "ms", "share");
    const auto row = [&](const std::string& name, const std::string& launches, double ms) {
        text +=
            fmt::format("{:<28}{:>9}{:>10.3f}{:>7.1f}%\n", name, launches, ms, 100.0 * ms / times.wall_ms);
    };
    for (const auto& [name, kernel] : rows) row(name, fmt::format("{:.3g}", kernel.launches), kernel.ms);
    if (rows.empty()) text += "The times of the kernels are unknown, because the device has no timestamps.\n";
    else row("between kernels", "", times.compute_idle_ms());
    row("step, wall time", "", times.wall_ms);
    return text + fmt::format("{:.2f} steps/s\n", 1e3 / times.wall_ms);
}

std::string steps_json(const TrainingStepTimes& times, const Device& device, const std::string& args) {
    nlohmann::ordered_json kernels = nlohmann::ordered_json::object();
    for (const auto& [name, kernel] : times.kernels)
        kernels[name] = {{"launches", kernel.launches}, {"ms", kernel.ms}};
    const nlohmann::ordered_json json = {{"format", "relidar-dev bench steps"},
                                         {"version", 1},
                                         {"relidar", RELIDAR_VERSION},
                                         {"command", args},
                                         {"device", device.info().name},
                                         {"steps", times.n_steps},
                                         {"surfels", times.surfels},
                                         {"rays", times.rays},
                                         {"kept_hits", times.stored_hits_per_ray},
                                         {"wall_ms", times.wall_ms},
                                         {"between_ms", times.compute_idle_ms()},
                                         {"kernels", kernels}};
    return json.dump(1) + "\n";
}

}  // namespace relidar::cli
