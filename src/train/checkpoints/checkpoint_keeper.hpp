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
#include <vector>

#include <relidar/log/log.hpp>
#include <relidar/run/checkpoint.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/train/train.hpp>

#include "train/reports/iteration_reports.hpp"

namespace relidar {

/// A property that must not change when training is resumed: its key in a checkpoint, its
/// name in messages, and its current value.
struct ResumeFingerprint {
    std::string key, what, value;
};

/// Returns hashes of the log, ordered by how well they explain a difference.
std::vector<ResumeFingerprint> fingerprint_log(const Log& log, const Split& split);
ResumeFingerprint fingerprint_scene(const Scene& scene);

std::map<std::string, std::string> make_resume_texts(const std::vector<ConfigKey>& settings,
                                                     const std::vector<ResumeFingerprint>& fingerprints);
/// Compares settings and hashes with the values in a checkpoint.
/// @param prefix  start of the error message
/// @throws UsageError if a setting has another value
/// @throws DataError if a setting is missing or a hash differs
void check_settings(const std::vector<ConfigKey>& settings, const Checkpoint& checkpoint,
                    const std::string& prefix);
void check_fingerprints(const std::vector<ResumeFingerprint>& fingerprints, const Checkpoint& checkpoint,
                        const std::string& prefix);
/// Returns the settings that a checkpoint contains, as key and value.
/// @throws DataError for an unknown key
std::map<std::string, std::string> read_settings(const Checkpoint& checkpoint);

/// Writes the training log, the time of the initialisation and the training time to a
/// checkpoint.
/// @param training_time_s  seconds since training started
void write_log(CheckpointWriter& writer, const TrainResult& result, double training_time_s);
void read_log(const Checkpoint& checkpoint, const Config& config, TrainResult& result);

/// @throws DataError if its arrays or its layout are invalid
Scene read_scene(const Checkpoint& checkpoint);

/// Adds a line to the training log. Estimates the remaining time from the speed after the
/// first line, because drivers still compile kernels before. In the first line it is
/// infinite.
/// @param elapsed_s  seconds since training started
void append_log_line(std::vector<TrainProgress>& log, const TrainLogLine& line, const Config& config,
                     double elapsed_s);

class CheckpointFolder {
public:
    using Texts = std::map<std::string, std::string>;
    struct Options {
        std::filesystem::path folder;  ///< if empty, no checkpoint is written
        int newest_iteration = 0;      ///< of the checkpoints in the folder, 0 if there is none
        std::string iteration_noun;    ///< for messages
        double minutes = 0.0;          ///< interval of is_time_due(), never if 0
        std::function<void(const std::string&)> report_note;
        /// Returns the settings and hashes that every checkpoint contains. Called by a
        /// separate thread, because hashing a log takes some time.
        std::function<Texts()> make_texts;
    };
    /// Keeps the two newest checkpoints, because a crash can damage the newest.
    explicit CheckpointFolder(Options options);

    bool is_enabled() const { return !options_.folder.empty(); }
    /// Returns 0 if the folder has no checkpoint.
    int newest_iteration() const { return options_.newest_iteration; }
    /// Writes a checkpoint. If the disk or the memory is full, prints a note and training
    /// continues.
    /// @param add_state adds the training state to the checkpoint
    /// @throws DataError if the state contains NaN or infinity
    void save(int iteration, const std::function<void(Checkpoint&)>& add_state);
    /// Counted from the last save(), or from the start.
    bool is_time_due() const;

private:
    using Clock = std::chrono::steady_clock;
    Options options_;
    std::shared_future<Texts> texts_;
    Clock::time_point last_ = Clock::now();
};

class CheckpointKeeper {
public:
    CheckpointKeeper(const Log& log, const Split& split, const Config& config, const TrainSession& session);

    /// After a number of iterations or minutes. The last iteration also gets a checkpoint
    /// if the folder already has one.
    bool is_due(int step) const;
    /// @param add_state adds the training state to the checkpoint
    void save_state(const std::function<void(Checkpoint&)>& add_state, const TrainResult& result,
                    double training_time_s);

private:
    const TrainConfig& config_;
    CheckpointFolder folder_;
};

}  // namespace relidar
