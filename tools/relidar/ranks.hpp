// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <relidar/base/process_group.hpp>

#include "options.hpp"

namespace relidar::cli {

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
