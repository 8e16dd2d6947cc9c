// SPDX-License-Identifier: Apache-2.0
// Replaces ranks.cpp in builds without MPI, which always run as a single process. If
// mpirun starts several processes, the program stops with an error that names the missing
// package.
#include "ranks.hpp"

#include <relidar/base/error.hpp>
#include "launched_by_mpi.hpp"

namespace relidar::cli {

Ranks::Ranks() {
    if (is_launched_by_mpi())
        throw UsageError(
            "mpirun has started this program, but it was built without MPI; install libopenmpi-dev "
            "and build relidar again");
}
Ranks::~Ranks() = default;
std::vector<std::string> Ranks::gather(const std::string& text) const { return {text}; }
void Ranks::wait_for_all() const {}
DeviceChoice Ranks::device(DeviceChoice chosen) const { return chosen; }

}  // namespace relidar::cli
