// SPDX-License-Identifier: Apache-2.0
// Replaces ranks.cpp in builds without MPI, which always run as a single process. If
// mpirun starts several processes, the program stops with an error that names the missing
// package.
#include "ranks.hpp"

#include <relidar/base/error.hpp>

namespace relidar::cli {

MpiProcessGroup::MpiProcessGroup() {
    if (is_mpi_process())
        throw UsageError(
            "mpirun has started this program, but it was built without MPI; install libopenmpi-dev and build "
            "relidar again");
}
MpiProcessGroup::~MpiProcessGroup() = default;
std::vector<std::string> MpiProcessGroup::gather_texts(const std::string& text) const { return {text}; }
void MpiProcessGroup::barrier() const {}
DeviceCommandOptions MpiProcessGroup::select_device(DeviceCommandOptions user_device_choice) const {
    return user_device_choice;
}

}  // namespace relidar::cli
