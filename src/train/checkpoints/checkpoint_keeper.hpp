// SPDX-License-Identifier: Apache-2.0
// Decides when a training writes a checkpoint. Prints a note if a checkpoint cannot be
// written. Private to train.
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

class CheckpointFolder {
public:
    /// Keeps the two newest checkpoints, because a failure of the machine can damage the
    /// newest.
    /// @param folder  if empty, no checkpoint is written
    /// @param newest_iteration  of the checkpoints in the folder, 0 if there is none
    CheckpointFolder(std::filesystem::path folder, int newest_iteration, std::string iteration_noun,
                     const std::function<void(const std::string&)>& report_note);

    bool is_enabled() const { return !folder_.empty(); }
    int newest() const { return newest_; }
    /// If the disk or the memory is full, prints a note and training continues.
    /// @throws DataError if the state contains NaN or infinity
    void save(Checkpoint checkpoint, const std::function<void(Checkpoint&)>& add_state);

private:
    const std::filesystem::path folder_;
    int newest_;
    const std::string count_;
    const std::function<void(const std::string&)> note_;
};

class CheckpointKeeper {
public:
    CheckpointKeeper(const Log& log, const Split& split, const Config& config, const TrainSession& session);

    /// After a number of iterations or minutes. The last iteration also gets a checkpoint
    /// if the folder already has one.
    bool is_due(int step) const;
    void save_state(TrainLoop& loop, const TrainResult& result, double training_time_s);

private:
    using Clock = std::chrono::steady_clock;
    const TrainConfig& config_;
    CheckpointFolder folder_;
    /// Settings and hashes that every checkpoint of this training contains. Computed by a
    /// separate thread, because hashing a log takes some time.
    std::shared_future<std::map<std::string, std::string>> texts_;
    Clock::time_point last_ = Clock::now();
};

}  // namespace relidar
