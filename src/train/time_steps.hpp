// SPDX-License-Identifier: Apache-2.0
// Times training steps on a trained run's own batches, kernel by kernel.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>

#include <relidar/gpu/device.hpp>
#include <relidar/run/run.hpp>

namespace relidar {

/// Means over steps, as they are at the end of a run's training.
struct StepTimes {
    /// Of one kernel in one step.
    struct Kernel {
        double launches = 0.0, ms = 0.0;
    };
    int n_steps = 0;
    std::map<std::string, Kernel> kernels;  ///< none where the device has no timestamps
    double kernels_ms = 0.0;                ///< of all of them
    double wall_ms = 0.0;
    std::size_t surfels = 0, rays = 0;  ///< of the scene, of a batch
    std::uint32_t kept_hits = 0;        ///< of a ray, at the end

    double between_ms() const { return wall_ms - kernels_ms; }  ///< no kernel runs
};

/// The most steps that are timed: the times of so many launches are kept.
inline constexpr int kMostTimedSteps = 500;

/// Trains on from a run's scene, at the rates of its last steps, and times that; the run
/// stays as it is.
/// @param run  with the scans of its training frames @param n_steps  after some that warm
/// up, 1 to kMostTimedSteps
/// @param stop  asked after each step; true ends it
/// @throws UsageError for a run in blocks; as train()
StepTimes time_steps(Device& device, const Run& run, int n_steps, const std::function<bool()>& stop = {});

}  // namespace relidar
