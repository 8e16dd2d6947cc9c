// SPDX-License-Identifier: Apache-2.0
// Coordinates the processes that mpirun has started.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <relidar/base/process_group.hpp>

#include "options.hpp"

namespace relidar::cli {

/// Represents this process in a group of MPI processes that work on the same job. With a
/// single process, no function waits or communicates. If an exception destroys this
/// object, the other processes are not notified, and mpirun terminates them.
class MpiProcessGroup {
public:
    /// Joins the group of processes that mpirun has started.
    /// @throws UsageError if mpirun started a program that was built without MPI, or if
    /// the processes run different builds
    MpiProcessGroup();
    ~MpiProcessGroup();
    MpiProcessGroup(const MpiProcessGroup&) = delete;
    MpiProcessGroup& operator=(const MpiProcessGroup&) = delete;

    int size() const { return group_.size; }
    /// Returns true in the first process, which prints messages and writes the shared
    /// files.
    bool is_first_mpi_process() const { return group_.is_first_process(); }
    /// Returns the process group, which library functions use to divide work among the
    /// processes.
    const ProcessGroup& get_process_group() const { return group_; }
    /// Sends the text of each process to the first process.
    /// @return in the first process, the texts in the order of ranks; in all other
    /// processes, an empty list
    std::vector<std::string> gather_texts_on_first_rank(const std::string& text) const;
    /// Waits until all processes have called this function. The process sleeps while it
    /// waits.
    void wait_for_all_ranks() const;
    /// Selects a GPU for this process, so that the processes of one machine use different
    /// GPUs. If the user has chosen a device, returns the user's choice.
    DeviceCommandOptions select_device_unless_user_chose(DeviceCommandOptions user_device_choice) const;

private:
    ProcessGroup group_;
    int local_rank_ = 0;
};

}  // namespace relidar::cli
