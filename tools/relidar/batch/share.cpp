// SPDX-License-Identifier: Apache-2.0
#include "batch/share.hpp"

#include <charconv>
#include <cstdlib>
#include <string_view>

#include <fmt/format.h>

#include <relidar/error.hpp>

namespace relidar::cli {
namespace {

constexpr const char *kSlurmTask = "SLURM_ARRAY_TASK_ID", *kKubernetesTask = "JOB_COMPLETION_INDEX";

/// Number in a variable of the environment; nothing where it is not set.
std::optional<int> environment_number(const char* name) {
    const char* found = std::getenv(name);
    if (!found) return std::nullopt;
    const std::string_view text = found;
    int value = 0;
    const char* end = text.data() + text.size();
    const auto [stop, error] = std::from_chars(text.data(), end, value);
    if (error != std::errc() || stop != end || value < 0)
        throw UsageError(fmt::format("{}: found \"{}\", expected a number; --task and --tasks say which jobs instead", name,
                                     text.substr(0, 80)));
    return value;
}

/// The whole array; its indices need not start at 0, but every one of their row must be there.
Share slurm_share(int id) {
    const int count = environment_number("SLURM_ARRAY_TASK_COUNT").value_or(1);
    const int first = environment_number("SLURM_ARRAY_TASK_MIN").value_or(id);
    const int last = environment_number("SLURM_ARRAY_TASK_MAX").value_or(id);
    const int step = environment_number("SLURM_ARRAY_TASK_STEP").value_or(1);
    const bool even = step > 0 && count > 0 && id >= first && id <= last && (id - first) % step == 0 && (last - first) / step + 1 == count;
    if (!even)
        throw UsageError(fmt::format("{}: found {} of {} tasks from {} to {}, expected an array without gaps, or --task and --tasks",
                                     kSlurmTask, id, count, first, last));
    return {(id - first) / step, count};
}

Share checked(int task, int tasks) {
    if (tasks < 1) throw UsageError(fmt::format("--tasks: found {}, expected 1 or more", tasks));
    if (task < 0 || task >= tasks) throw UsageError(fmt::format("--task: found {}, expected 0 to {}", task, tasks - 1));
    return {task, tasks};
}

}  // namespace

Share find_share(std::optional<int> task, std::optional<int> tasks) {
    if (task && !tasks) throw UsageError("--task: found no --tasks beside it, expected of how many tasks it is one");
    if (task) return checked(*task, *tasks);
    const std::optional<int> slurm = environment_number(kSlurmTask), kubernetes = environment_number(kKubernetesTask);
    if (tasks && !slurm && !kubernetes)
        throw UsageError(fmt::format("--tasks: found no --task, {} or {}, expected which task this is", kSlurmTask, kKubernetesTask));
    if (tasks) return checked(slurm ? *slurm : *kubernetes, *tasks);
    if (slurm) return slurm_share(*slurm);
    if (kubernetes)
        throw UsageError(fmt::format("{}: found {}, but not of how many; expected --tasks N, the completions of the job", kKubernetesTask,
                                     *kubernetes));
    return {};
}

}  // namespace relidar::cli
