// SPDX-License-Identifier: Apache-2.0
// Which jobs of a batch are done by this process, where many share them: each job belongs to one task of so many.
#pragma once

#include <cstddef>
#include <optional>

namespace relidar::cli {

struct Share {
    int task = 0, tasks = 1;

    /// Jobs are dealt like cards, so that neighbours in a manifest, which are often alike, go to different tasks.
    bool has(std::size_t job) const { return job % static_cast<std::size_t>(tasks) == static_cast<std::size_t>(task); }
};

/// What --task and --tasks say; where they do not, the array of Slurm (SLURM_ARRAY_TASK_ID, _COUNT, _MIN, _MAX, _STEP) or the indexed job
/// of Kubernetes (JOB_COMPLETION_INDEX) that this process is part of; where there is none, all jobs.
/// @throws UsageError for numbers that do not fit each other, and where an index does not say of how many
Share find_share(std::optional<int> task, std::optional<int> tasks);

}  // namespace relidar::cli
