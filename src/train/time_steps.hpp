// SPDX-License-Identifier: Apache-2.0
// Measures the time of training steps on the batches of a trained run, for each kernel.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>

#include <relidar/gpu/device.hpp>
#include <relidar/run/run.hpp>

namespace relidar {

/// Mean times of training steps, as at the end of a run's training.
struct StepTimes {
    /// Mean of a kernel in a step.
    struct Kernel {
        double launches = 0.0, ms = 0.0;
    };
    int n_steps = 0;
    std::map<std::string, Kernel> kernels;  ///< times by kernel; empty if the device has no timestamps
    double kernels_ms = 0.0;                ///< sum over all kernels
    double wall_ms = 0.0;
    std::size_t surfels = 0, rays = 0;  ///< surfels in the scene; rays in a batch
    std::uint32_t kept_hits = 0;        ///< hits kept for each ray at the end

    double between_ms() const { return wall_ms - kernels_ms; }  ///< time in which no kernel runs
};

/// Maximum number of timed steps, because the times of all launches are kept in memory.
inline constexpr int kMostTimedSteps = 500;

/// Continues training from a run's scene, with the learning rates of its last steps, and
/// measures the time. Does not change the run.
/// @param run  a run with the scans of its training frames
/// @param n_steps  number of timed steps after a few warm-up steps, 1 to kMostTimedSteps
/// @param stop  polled after each step; if it returns true, the measurement ends
/// @throws UsageError for a run in blocks; otherwise like train()
StepTimes time_steps(Device& device, const Run& run, int n_steps, const std::function<bool()>& stop = {});

}  // namespace relidar
