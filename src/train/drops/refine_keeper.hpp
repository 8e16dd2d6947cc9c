// SPDX-License-Identifier: Apache-2.0
// Checkpoints of the ray-drop network's training: after each epoch, by time, and where it
// stops. Private to train.
#pragma once

#include <chrono>
#include <functional>
#include <future>
#include <map>
#include <string>

#include <relidar/diff/network.hpp>
#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>

#include "train/checkpoints/checkpoint_keeper.hpp"

namespace relidar {

class RefineKeeper {
public:
    RefineKeeper(const Run& run, const RefineSession& session);

    /// Writes a checkpoint where one is due. @throws DataError where the state is not
    /// finite
    void after_step(const RefineProgress& progress, bool stops, const std::function<RefineState()>& state);

private:
    using Clock = std::chrono::steady_clock;
    const double minutes_;
    CheckpointFolder folder_;
    /// of every checkpoint of this training; hashes of a log take a while
    std::shared_future<std::map<std::string, std::string>> texts_;
    Clock::time_point last_ = Clock::now();
};

/// The state in a checkpoint. @throws DataError where it is not one of a network's
/// training
RefineState refine_state(const Checkpoint& checkpoint);

}  // namespace relidar
