// SPDX-License-Identifier: Apache-2.0
// When a training writes a checkpoint, and what a failure to write one means. Private to train.
#pragma once

#include <chrono>
#include <map>
#include <string>

#include <relidar/train.hpp>

namespace relidar {

class TrainLoop;

class CheckpointKeeper {
public:
    CheckpointKeeper(const Sequence& sequence, const Split& split, const Config& config, const TrainSession& session);

    /// After this iteration: by count, by time, or the last one of a run long enough to have had one before.
    bool due(int step) const;
    /// Writes the state after result.iterations. A disk that cannot take it costs a note, not the training.
    /// @throws DataError where the state is not finite: nothing could continue from it
    void save(TrainLoop& loop, const TrainResult& result, double train_s);

private:
    using Clock = std::chrono::steady_clock;
    const TrainConfig& config_;
    const TrainSession& session_;
    std::map<std::string, std::string> texts_;   ///< of every checkpoint of this training
    int newest_;                                 ///< iteration of the newest one on the disk; 0 = none
    Clock::time_point last_ = Clock::now();
};

}  // namespace relidar
