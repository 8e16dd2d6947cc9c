// SPDX-License-Identifier: Apache-2.0
// How far a job of a batch is: one file in its folder, job.json, written whole or not at all by whoever holds the folder's lock. These
// files are all that a batch remembers.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

namespace relidar::cli {

enum class JobPhase {
    waiting,     ///< nobody has begun it
    running,     ///< somebody is at it, or died at it
    done,
    failed,      ///< tried again on demand alone
    preempted    ///< told to stop before it was done; goes on with the next batch
};

struct JobState {
    JobPhase phase = JobPhase::waiting;
    std::vector<std::string> done;         ///< commands that are done, as the manifest has them; the first is the training
    std::string doing;                     ///< the command at work, or at which it ended
    int exit_code = 0;                     ///< of that command; 128 + signal where a signal ended it
    std::string message;                   ///< its one line
    int attempts = 0;                      ///< how often the job was taken up
    double seconds = 0.0;                  ///< of all commands that came to an end
    std::string host;                      ///< who took it up last
    int process = 0;
    std::string changed;                   ///< when this was written, UTC
    std::map<std::string, double> metrics; ///< means over the held-out frames; empty: not scored
};

std::string phase_name(JobPhase phase);

/// State of the job in a folder; waiting where nothing is known of it. @throws DataError where job.json is not what it should be
JobState load_state(const std::filesystem::path& folder);
JobState parse_state(const std::string& text, const std::string& file);

/// @throws DataError where it cannot be written
void save_state(const std::filesystem::path& folder, const JobState& state);

std::string utc_now();   ///< "2026-11-21T12:30:00Z"

}  // namespace relidar::cli
