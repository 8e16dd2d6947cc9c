// SPDX-License-Identifier: Apache-2.0
// The group of processes that mpirun has started.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <relidar/base/process_group.hpp>

#include "options.hpp"

namespace relidar::cli {

/// One of several processes that share a job and its output folder. With a single
/// process, all functions do nothing. If an exception destroys this object, the process
/// ends without notifying the others, and mpirun terminates them.
class Ranks {
public:
    /// Joins the process group.
    /// @throws UsageError if mpirun started a program that was built without MPI, or
    /// different builds
    Ranks();
    ~Ranks();
    Ranks(const Ranks&) = delete;
    Ranks& operator=(const Ranks&) = delete;

    int size() const { return group_.size; }
    /// Returns true for the process that prints and writes the shared files.
    bool is_first() const { return group_.is_first(); }
    /// Returns the group that library functions use to share work.
    const ProcessGroup& group() const { return group_; }
    /// Sends a text from each process to the first process.
    /// @return in the first process: the texts in order of ranks; in the others: an empty
    /// list
    std::vector<std::string> gather(const std::string& text) const;
    /// Waits until all processes have called this function. Waiting uses no processor
    /// time.
    void wait_for_all() const;
    /// Assigns the GPUs of a machine to its processes in turn, unless the user has chosen
    /// a device.
    DeviceChoice device(DeviceChoice chosen) const;

private:
    ProcessGroup group_;
    int local_rank_ = 0;
};

}  // namespace relidar::cli
