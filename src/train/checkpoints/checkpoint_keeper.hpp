// SPDX-License-Identifier: Apache-2.0
// When a training writes a checkpoint, and what a failure to write one means. Private to
// train.
#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <future>
#include <map>
#include <string>

#include <relidar/run/checkpoint.hpp>
#include <relidar/train/train.hpp>

namespace relidar {

class TrainLoop;

/// Checkpoints of one training, written into a folder without ever stopping it.
class CheckpointFolder {
public:
    /// The newest two are kept: one may be damaged where a machine fails.
    /// @param folder  none: nothing is written @param newest  iteration of the newest
    /// checkpoint in it; 0: none
    /// @param count  what iterations are called, for messages: "iteration"
    CheckpointFolder(std::filesystem::path folder, int newest, std::string count,
                     const std::function<void(const std::string&)>& note);

    bool wanted() const { return !folder_.empty(); }
    int newest() const { return newest_; }
    /// Writes one. A disk or a memory that cannot take it costs a note, not the training.
    /// @param fill  puts the state in @throws DataError where the state is not finite:
    /// nothing could continue from it
    void save(Checkpoint checkpoint, const std::function<void(Checkpoint&)>& fill);

private:
    const std::filesystem::path folder_;
    int newest_;
    const std::string count_;
    const std::function<void(const std::string&)> note_;
};

class CheckpointKeeper {
public:
    CheckpointKeeper(const Sequence& sequence, const Split& split, const Config& config,
                     const TrainSession& session);

    /// After this iteration: by count, by time, or the last one of a run long enough to
    /// have had one before.
    bool due(int step) const;
    /// Writes the state after result.iterations. A disk that cannot take it costs a note,
    /// not the training.
    /// @throws DataError where the state is not finite: nothing could continue from it
    void save(TrainLoop& loop, const TrainResult& result, double train_s);

private:
    using Clock = std::chrono::steady_clock;
    const TrainConfig& config_;
    CheckpointFolder folder_;
    /// of every checkpoint of this training; hashes of a log take a while
    std::shared_future<std::map<std::string, std::string>> texts_;
    Clock::time_point last_ = Clock::now();
};

}  // namespace relidar
