// SPDX-License-Identifier: Apache-2.0
// What a batch will do: the jobs of a manifest as folders and command lines. Nothing is looked up on disk.
#pragma once

#include <algorithm>
#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include "batch/manifest.hpp"

namespace relidar::cli {

struct DeviceChoice;

/// One call of relidar.
struct JobCommand {
    std::string text;                 ///< as the manifest has it, without folders and devices: what a job remembers as done
    std::vector<std::string> words;   ///< all arguments

    bool is_in(const std::vector<std::string>& texts) const { return std::find(texts.begin(), texts.end(), text) != texts.end(); }
};

struct PlannedJob {
    BatchJob job;
    std::filesystem::path folder;       ///< DIR/NAME: job.json, batch.log, what steps write
    std::filesystem::path run;          ///< DIR/NAME/run, or where the manifest wants it
    std::vector<JobCommand> commands;   ///< training, then the steps

    std::filesystem::path log() const { return folder / "batch.log"; }
    /// How many of its commands are in a list of texts: the manifest may have other steps than when they were done.
    std::size_t n_done(const std::vector<std::string>& done) const {
        return std::size_t(std::count_if(commands.begin(), commands.end(), [&](const JobCommand& command) { return command.is_in(done); }));
    }
    bool is_done(const std::vector<std::string>& done) const { return n_done(done) == commands.size(); }
};

struct BatchPlan {
    std::filesystem::path manifest, out;   ///< absolute
    std::vector<PlannedJob> jobs;
};

/// @param out folder of the batch, absolute @param device for every command that takes one @throws UsageError for a step that is no command
/// of a job, or one that names something in braces that is not known
BatchPlan plan_batch(const BatchManifest& manifest, const std::filesystem::path& out, const DeviceChoice& device);

}  // namespace relidar::cli
