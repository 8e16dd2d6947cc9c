// SPDX-License-Identifier: Apache-2.0
// In the place of ranks.cpp where MPI was not there to build with: one process, and
// mpirun is told what is missing.
#include "ranks.hpp"

#include <relidar/base/error.hpp>
#include "launched_by_mpi.hpp"

namespace relidar::cli {

Ranks::Ranks() {
    if (launched_by_mpi())
        throw UsageError(
            "started by mpirun: this program was built without MPI, expected one with it: install "
            "libopenmpi-dev, then build "
            "again");
}
Ranks::~Ranks() = default;
std::vector<std::string> Ranks::gather(const std::string& text) const { return {text}; }
void Ranks::wait_for_all() const {}
DeviceChoice Ranks::device(DeviceChoice chosen) const { return chosen; }

}  // namespace relidar::cli
