// SPDX-License-Identifier: Apache-2.0
#include "train/time_steps.hpp"

#include <algorithm>
#include <chrono>

#include "base/fail.hpp"
#include "train/train_loop.hpp"

namespace relidar {
namespace {

constexpr int kWarmUp = 5;  // iterations before the measurement

using KernelTotals = std::map<std::string, KernelTimes::LaunchTotals>;

/// Returns the time and number of launches of each kernel per step.
/// @param before,after totals before and after `n_steps` timed steps
std::map<std::string, TrainingStepTimes::StepKernelTime> mean_kernel_times(KernelTotals before,
                                                                           const KernelTotals& after,
                                                                           int n_steps) {
    std::map<std::string, TrainingStepTimes::StepKernelTime> result;
    for (const auto& [kernel, total] : after) {
        const KernelTimes::LaunchTotals& earlier = before[kernel];  // zeros for a new kernel
        if (total.launches == earlier.launches) continue;
        result[kernel] = {.launches = (total.launches - earlier.launches) / n_steps,
                          .ms = (total.ms - earlier.ms) / n_steps};
    }
    return result;
}

}  // namespace

TrainingStepTimes measure_steps(Device& device, const Run& run, int n_steps,
                                const std::function<bool()>& stop) {
    if (!run.scene.blocks.empty())
        fail<UsageError>(
            "cannot measure the training speed of {}: the run is divided into blocks; use a run that was "
            "trained without blocks",
            run.folder.string());
    if (n_steps < 1 || n_steps > kMostTimedSteps)
        fail<UsageError>("cannot measure the training speed: found {} steps, expected 1 to {}", n_steps,
                         kMostTimedSteps);
    TrainLoop loop(device, run.log, run.split, run.scene, run.config);
    // Runs the last iterations of the training (or the first): the warm-up, then n_steps.
    const int first = std::max(1, run.config.train.iterations - n_steps - kWarmUp + 1);
    for (int k = 0; k < kWarmUp; ++k) loop.run_iteration(first + k);
    loop.finish_steps();
    const KernelTotals warm_up_totals = loop.training_times().totals;
    TrainingStepTimes result;
    const auto start = std::chrono::steady_clock::now();
    while (result.n_steps < n_steps && !(stop && stop())) {
        loop.run_iteration(first + kWarmUp + result.n_steps);
        ++result.n_steps;
    }
    // The device must be finished before the clock stops.
    loop.finish_steps();
    if (result.n_steps == 0) return result;
    result.wall_ms = 1e3 * std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() /
                     result.n_steps;
    result.kernels = mean_kernel_times(warm_up_totals, loop.training_times().totals, result.n_steps);
    for (const auto& [kernel, time] : result.kernels) result.kernels_ms += time.ms;
    result.surfels = loop.surfel_count();
    result.rays = loop.last_batch_rays();
    result.stored_hits_per_ray = loop.max_stored_hits();
    return result;
}

}  // namespace relidar
