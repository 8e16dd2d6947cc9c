// SPDX-License-Identifier: Apache-2.0
// What a batch will do: the jobs of a manifest as folders and command lines. Nothing is looked up on disk.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "batch_manifest.hpp"

namespace relidar::cli {

struct DeviceChoice;

/// One call of relidar.
struct JobCommand {
    std::string text;                 ///< as the manifest has it, without folders and devices: what a job remembers as done
    std::vector<std::string> words;   ///< all arguments
};

struct PlannedJob {
    BatchJob job;
    std::filesystem::path folder;       ///< DIR/NAME: job.json, batch.log, what steps write
    std::filesystem::path run;          ///< DIR/NAME/run, or where the manifest wants it
    std::vector<JobCommand> commands;   ///< training, then the steps

    std::filesystem::path log() const { return folder / "batch.log"; }
};

struct BatchPlan {
    std::filesystem::path manifest, out;   ///< absolute
    std::vector<PlannedJob> jobs;
};

/// @param out folder of the batch, absolute @param device for every command that takes one @throws UsageError for a step that is no command
/// of a job, or one that names something in braces that is not known
BatchPlan plan_batch(const BatchManifest& manifest, const std::filesystem::path& out, const DeviceChoice& device);

}  // namespace relidar::cli
