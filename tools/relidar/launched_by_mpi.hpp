// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdlib>

namespace relidar::cli {

/// A process that was started alone must not initialise MPI, which may not be set up.
inline bool is_mpi_process() {
    // Open MPI sets the first, MPICH and Intel MPI the second, Slurm either of them.
    for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE"})
        if (const char* size = std::getenv(name); size && std::atoi(size) > 1) return true;
    return false;
}

}  // namespace relidar::cli
