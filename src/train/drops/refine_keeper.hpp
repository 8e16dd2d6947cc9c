// SPDX-License-Identifier: Apache-2.0
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

class RayDropCheckpointKeeper {
public:
    RayDropCheckpointKeeper(const Run& run, const RayDropTrainingSession& session);

    /// @throws DataError if the state is not finite
    void save_due(const RayDropTrainProgress& progress, bool is_stopping,
                  const std::function<RayDropTrainState()>& get_state);

private:
    using Clock = std::chrono::steady_clock;
    const double minutes_;
    CheckpointFolder folder_;
    /// Settings and hashes that every checkpoint of this training contains. Computed by a
    /// separate thread, because hashing a log takes some time.
    std::shared_future<std::map<std::string, std::string>> texts_;
    Clock::time_point last_ = Clock::now();
};

/// @throws DataError if the checkpoint is not from the training of a network
RayDropTrainState read_drop_state(const Checkpoint& checkpoint);

}  // namespace relidar
