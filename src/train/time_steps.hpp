// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>

#include <relidar/gpu/device.hpp>
#include <relidar/run/run.hpp>

namespace relidar {

struct TrainingStepTimes {
    struct StepKernelTime {
        double launches = 0.0, ms = 0.0;
    };
    int n_steps = 0;
    std::map<std::string, StepKernelTime>
        kernels;              ///< times by kernel; empty if the device has no timestamps
    double kernels_ms = 0.0;  ///< sum over all kernels
    double wall_ms = 0.0;
    std::size_t surfels = 0, rays = 0;      ///< surfels in the scene; rays in the last batch
    std::uint32_t stored_hits_per_ray = 0;  ///< maximum number of stored hits per ray after the last step

    double compute_idle_ms() const { return wall_ms - kernels_ms; }  ///< time in which no kernel runs
};

/// limited because the times of all kernel launches are kept in memory
inline constexpr int kMostTimedSteps = 500;

/// Trains a run for more steps with the learning rates of its last steps. Does not change
/// the run.
/// @param run  with the scans of its training frames
/// @param n_steps  timed steps after a few warm-up steps, 1 to kMostTimedSteps
/// @throws UsageError if the run has blocks; otherwise the same errors as train()
TrainingStepTimes measure_steps(Device& device, const Run& run, int n_steps,
                                const std::function<bool()>& stop = {});

}  // namespace relidar
