// SPDX-License-Identifier: Apache-2.0
// Coordinates the processes that mpirun has started.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <relidar/base/process_group.hpp>

#include "options.hpp"

namespace relidar::cli {

/// One of several MPI processes that share a job and its output folder. If there is only
/// one process, no function waits or communicates. If an exception destroys this object,
/// the process ends without notifying the others, and mpirun terminates the others.
class Ranks {
public:
    /// Joins the group of processes that mpirun has started.
    /// @throws UsageError if mpirun started a program without MPI support, or different
    /// builds of the program
    Ranks();
    ~Ranks();
    Ranks(const Ranks&) = delete;
    Ranks& operator=(const Ranks&) = delete;

    int size() const { return group_.size; }
    /// Returns true in the process that prints messages and writes the shared files.
    bool is_first() const { return group_.is_first(); }
    /// Returns the process group. Library functions use it to divide work among the
    /// processes.
    const ProcessGroup& group() const { return group_; }
    /// Sends the text of each process to the first process.
    /// @return in the first process: the texts in the order of ranks; in the others: an
    /// empty list
    std::vector<std::string> gather(const std::string& text) const;
    /// Waits until all processes have called this function. A waiting process uses no
    /// processor time.
    void wait_for_all() const;
    /// Selects a GPU for this process. The processes of a machine use its GPUs in turn.
    /// If the user has chosen a device, that device is returned.
    DeviceChoice device(DeviceChoice chosen) const;

private:
    ProcessGroup group_;
    int local_rank_ = 0;
};

}  // namespace relidar::cli
