// SPDX-License-Identifier: Apache-2.0
// All jobs of a batch at a glance, for people and as batch.json. Taken from the jobs' own files each time.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "batch/plan.hpp"
#include "batch/state.hpp"

namespace relidar::cli {

struct JobReport {
    const PlannedJob* job;
    JobState state;
    /// That of the state; "lost" where it says "running" and no process holds the job's lock, "waiting" where a step has come since.
    std::string phase;
};

/// @throws DataError for a state that is damaged
std::vector<JobReport> report_jobs(const BatchPlan& plan);

/// A row a job, a line for each that failed, totals, means of the metrics over the jobs that were scored.
std::string status_text(const std::vector<JobReport>& reports);

/// Ends the command as its jobs have ended: nothing where all are done. @throws Error of exit code 130 where some are neither done nor
/// failed, else of the code of a failed one, naming the first
void raise_ends(const std::vector<JobReport>& reports);

/// DIR/batch.json: the same. Processes write it one at a time, so that the last one has seen what all others did.
void write_summary(const BatchPlan& plan);

/// Means over the held-out frames of a run, as its metrics.json has them; empty where it was not scored.
std::map<std::string, double> mean_metrics(const std::filesystem::path& run);

}  // namespace relidar::cli
