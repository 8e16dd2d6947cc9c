// SPDX-License-Identifier: Apache-2.0
// Training from a log to a scene: initialise, iterate, report (the iteration itself is in train_loop.cpp).
#include <relidar/train.hpp>

#include <algorithm>
#include <chrono>
#include <numeric>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "train/train_loop.hpp"

namespace relidar {

namespace {

using Clock = std::chrono::steady_clock;
double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

TrainProgress progress_at(int step, const Config& config, double seconds, const std::array<double, kLossTerms>& terms, std::uint32_t n_surfels) {
    TrainProgress p;
    p.iteration = step;
    p.n_iterations = config.train.iterations;
    p.seconds = seconds;
    p.iterations_per_second = step / std::max(seconds, 1e-9);
    p.eta_s = (config.train.iterations - step) / std::max(p.iterations_per_second, 1e-9);
    p.terms = terms;
    p.loss = std::accumulate(terms.begin(), terms.end(), 0.0);
    p.n_surfels = n_surfels;
    return p;
}

}  // namespace

TrainResult train(Device& device, const Sequence& sequence, const Split& split, const Config& config, const ProgressCallback& progress) {
    if (split.train.empty()) throw DataError(fmt::format("training on {}: found no training frames, expected at least one", sequence.name));
    TrainResult result;
    const Clock::time_point begin = Clock::now();
    const Scene initial = initialise_scene(sequence, split.train, config.init);
    result.initialise_s = seconds_since(begin);

    TrainLoop loop(device, sequence, split, initial, config);
    const Clock::time_point start = Clock::now();
    int logged = 0;
    for (int step = 1; step <= config.train.iterations && !result.interrupted; ++step) {
        loop.iterate(step);
        const bool log_now = step == 1 || step % std::max(1, config.train.log_every) == 0 || step == config.train.iterations;
        if (!log_now) continue;
        const std::array<double, kLossTerms> terms = loop.take_terms(step - logged, step);
        logged = step;
        result.log.push_back(progress_at(step, config, seconds_since(start), terms, loop.n_surfels()));
        result.log.back().densified = loop.take_densified();
        result.interrupted = !progress(result.log.back());
    }
    if (config.densify.prune_unseen && !result.interrupted) loop.prune_unseen();
    result.scene = loop.download();
    if (config.train.sensor_drop && !result.interrupted) result.scene.sensor_drop = loop.estimate_sensor_drop(sequence);
    result.train_s = seconds_since(start);
    result.times = loop.times();
    result.peak_device_bytes = device.peak_bytes();
    return result;
}

}  // namespace relidar
