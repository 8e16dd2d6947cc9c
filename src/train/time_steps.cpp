// SPDX-License-Identifier: Apache-2.0
#include "train/time_steps.hpp"

#include <algorithm>
#include <chrono>

#include "base/fail.hpp"
#include "train/train_loop.hpp"

namespace relidar {
namespace {

constexpr int kWarmUp = 5;

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
    TrainLoop loop(device, run.sequence, run.split, run.scene, run.config);
    // Times the last iterations of the configured training.
    const int first = std::max(1, run.config.train.iterations - n_steps - kWarmUp + 1);
    for (int k = 0; k < kWarmUp; ++k) loop.run_iteration(first + k);
    loop.finish_steps();
    const std::map<std::string, KernelTimes::LaunchTotals> before = loop.training_times().totals;
    TrainingStepTimes result;
    const auto start = std::chrono::steady_clock::now();
    for (; result.n_steps < n_steps && !(stop && stop()); ++result.n_steps)
        loop.run_iteration(first + kWarmUp + result.n_steps);
    // The device must be finished before the clock stops.
    loop.finish_steps();
    if (result.n_steps == 0) return result;
    result.wall_ms = 1e3 * std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() /
                     result.n_steps;
    // Subtracts the launches of the warm-up.
    for (const auto& [kernel, sum] : loop.training_times().totals) {
        const auto earlier = before.find(kernel);
        const KernelTimes::LaunchTotals had =
            earlier == before.end() ? KernelTimes::LaunchTotals{} : earlier->second;
        if (sum.launches == had.launches) continue;
        result.kernels[kernel] = {(sum.launches - had.launches) / result.n_steps,
                                  (sum.ms - had.ms) / result.n_steps};
        result.kernels_ms += result.kernels[kernel].ms;
    }
    result.surfels = loop.surfel_count();
    result.rays = loop.last_batch_rays();
    result.stored_hits_per_ray = loop.max_stored_hits();
    return result;
}

}  // namespace relidar
