// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdlib>

namespace relidar::cli {

/// Returns true if mpirun, or a batch system, started this process together with others.
/// Otherwise MPI is not initialised, because MPI may not be set up on the machine.
inline bool launched_by_mpi() {
    // Variables of Open MPI; of MPICH and Intel MPI; Slurm sets them for either.
    for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE"})
        if (const char* size = std::getenv(name); size && std::atoi(size) > 1) return true;
    return false;
}

}  // namespace relidar::cli
