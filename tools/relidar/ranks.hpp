// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdlib>
#include <string>
#include <vector>

#include <relidar/base/process_group.hpp>

#include "options.hpp"

namespace relidar::cli {

/// A process that was started alone must not initialise MPI, which may not be set up.
inline bool is_mpi_process() {
    // Open MPI sets the first, MPICH and Intel MPI the second, Slurm either of them.
    for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE"})
        if (const char* size = std::getenv(name); size && std::atoi(size) > 1) return true;
    return false;
}

/// With a single process, no function waits or communicates. If an exception destroys
/// this object, mpirun terminates the other processes.
class MpiProcessGroup {
public:
    /// @throws UsageError if mpirun started a program that was built without MPI, or if
    /// the processes run different builds
    MpiProcessGroup();
    ~MpiProcessGroup();
    MpiProcessGroup(const MpiProcessGroup&) = delete;
    MpiProcessGroup& operator=(const MpiProcessGroup&) = delete;

    int size() const { return group_.size; }
    bool is_first() const { return group_.is_first(); }
    const ProcessGroup& group() const { return group_; }
    /// Collects the texts of all processes in the first process.
    /// @return in the first process, the texts in the order of ranks; elsewhere, an empty
    /// list
    std::vector<std::string> gather_texts(const std::string& text) const;
    /// Sleeps while it waits.
    void barrier() const;
    /// Different GPUs for the processes of one machine, unless the user has chosen a
    /// device.
    DeviceCommandOptions select_device(DeviceCommandOptions user_device_choice) const;

private:
    ProcessGroup group_;
    int local_rank_ = 0;
};

}  // namespace relidar::cli
