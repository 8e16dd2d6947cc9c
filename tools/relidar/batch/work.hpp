// SPDX-License-Identifier: Apache-2.0
// The work of one process at a batch: its jobs one after the other, each command of a job a process of its own.
#pragma once

#include "batch/plan.hpp"
#include "batch/share.hpp"

namespace relidar::cli {

struct WorkOptions {
    Share share;
    bool retry_failed = false;   ///< jobs that had failed before this process began
    bool quiet = false;
};

/// Does what is left of the share's jobs until all are done or have failed, or until this process is told to stop (interrupted()). A job
/// that another process is at is waited for: it may die and leave it. How jobs ended is in their folders (batch_state.hpp).
/// @throws DataError where a job's folder cannot be written
void work(const BatchPlan& plan, const WorkOptions& options);

}  // namespace relidar::cli
