// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <functional>

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
    CheckpointFolder folder_;
};

/// @throws DataError if the checkpoint is not from the training of a network
RayDropTrainState read_drop_state(const Checkpoint& checkpoint);

}  // namespace relidar
