// SPDX-License-Identifier: Apache-2.0
// The training loop: initialise, then sample a frame, render, compare, differentiate, step.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <vector>

#include <relidar/config.hpp>
#include <relidar/gpu.hpp>
#include <relidar/loss.hpp>
#include <relidar/scene.hpp>
#include <relidar/sequence.hpp>

namespace relidar {

/// One line of the log.
struct TrainProgress {
    int iteration = 0;
    int n_iterations = 0;
    double seconds = 0.0;                          ///< since training started
    double iterations_per_second = 0.0;
    double eta_s = 0.0;
    std::array<double, kLossTerms> terms{};        ///< weighted, mean over the iterations since the last line
    double loss = 0.0;
    std::uint32_t n_surfels = 0;
    DensifyReport densified;                       ///< sums over the densifications since the last line; `before` and `after` are of the last one
};

/// What training leaves behind.
struct TrainResult {
    Scene scene;
    std::vector<TrainProgress> log;
    KernelTimes times;
    double initialise_s = 0.0;
    double train_s = 0.0;
    std::uint64_t peak_device_bytes = 0;
    bool interrupted = false;
};

/// Called at every log line. Returning false stops training after the current iteration; the result holds the scene so far.
using ProgressCallback = std::function<bool(const TrainProgress&)>;

/// Trains a scene on the training frames of a log.
/// @throws DataError where there is nothing to train on; DeviceError on the device's failures; DataError naming iteration, frame and
/// term where a loss is not finite
TrainResult train(Device& device, const Sequence& sequence, const Split& split, const Config& config, const ProgressCallback& progress);

}  // namespace relidar
