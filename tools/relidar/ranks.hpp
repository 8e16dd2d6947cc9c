// SPDX-License-Identifier: Apache-2.0
// The processes that mpirun has started together.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <relidar/base/process_group.hpp>

#include "options.hpp"

namespace relidar::cli {

/// One of several processes that share a job and its folder, or the only one: then
/// everything here does nothing. Where an exception leaves it, the process ends without a
/// word to the others, and mpirun ends them.
class Ranks {
public:
    /// Joins the others. @throws UsageError where mpirun has started a program that was
    /// built without MPI, or several builds
    Ranks();
    ~Ranks();
    Ranks(const Ranks&) = delete;
    Ranks& operator=(const Ranks&) = delete;

    int size() const { return group_.size; }
    /// Of them, the one that prints, and writes what they share.
    bool is_first() const { return group_.is_first(); }
    /// For the library's work that they share.
    const ProcessGroup& group() const { return group_; }
    /// Brings a text of each process to the first. @return [size] there, in order of
    /// ranks; elsewhere nothing
    std::vector<std::string> gather(const std::string& text) const;
    /// Returns once all have come here. Takes no time of the processor.
    void wait_for_all() const;
    /// A GPU for each process of a machine, in turn, where none was chosen.
    DeviceChoice device(DeviceChoice chosen) const;

private:
    ProcessGroup group_;
    int local_rank_ = 0;
};

}  // namespace relidar::cli
