// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdlib>

namespace relidar::cli {

/// Whether mpirun, or an engine in its place, has started this process with others:
/// without them MPI is left alone, which may not even be set up on the machine.
inline bool launched_by_mpi() {
    // Open MPI; MPICH, Intel MPI, and Slurm with either
    for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE"})
        if (const char* size = std::getenv(name); size && std::atoi(size) > 1) return true;
    return false;
}

}  // namespace relidar::cli
