// SPDX-License-Identifier: Apache-2.0
// What becomes of memory that was freed. Arrays of a whole log come and go in every
// stage; pages that go back to the system between two of them are made anew, a fifth to a
// third of the time that a registration takes. Only glibc is told; elsewhere both do
// nothing. Tests run with the same limits (GLIBC_TUNABLES in CMakePresets.json).
#pragma once

#include <cstddef>  // defines __GLIBC__

#ifdef __GLIBC__
#include <malloc.h>
#endif

namespace relidar::cli {

/// From now on the process keeps it for what comes next, up to 256 MiB and what lies
/// between other arrays. Called once, at the start.
inline void keep_freed_memory() {
#ifdef __GLIBC__
    constexpr int kMiB = 1 << 20;
    mallopt(M_MMAP_THRESHOLD, 128 * kMiB);
    mallopt(M_TRIM_THRESHOLD, 256 * kMiB);
    mallopt(M_TOP_PAD, 32 * kMiB);
#endif
}

/// What is kept goes back to the system: called before a stage that needs other memory,
/// as a device that shares the host's does.
inline void give_back_freed_memory() {
#ifdef __GLIBC__
    malloc_trim(0);
#endif
}

}  // namespace relidar::cli
