// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdlib>

namespace relidar::cli {

/// Returns true if mpirun or a batch system started this process as one of several. A
/// process that was started alone must not initialise MPI, because MPI may not be set up
/// on this machine.
inline bool is_launched_by_mpi() {
    // Names of environment variables that hold the number of processes. Open MPI sets the
    // first variable. MPICH and Intel MPI set the second variable. Slurm may set either
    // of them.
    for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE"})
        if (const char* size = std::getenv(name); size && std::atoi(size) > 1) return true;
    return false;
}

}  // namespace relidar::cli
