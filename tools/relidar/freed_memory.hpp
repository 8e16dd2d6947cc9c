// SPDX-License-Identifier: Apache-2.0
// Controls when freed memory is returned to the system. Each stage of a training
// allocates and frees arrays as large as the log. Returning and allocating these pages
// again would take a fifth to a third of the time of a registration. The functions have
// an effect only with glibc. Tests set the same limits (GLIBC_TUNABLES in
// CMakePresets.json).
#pragma once

#include <cstddef>  // Included because any standard header defines __GLIBC__ on systems with glibc.

#ifdef __GLIBC__
#include <malloc.h>
#endif

namespace relidar::cli {

/// Lets the process keep up to 256 MiB of freed memory, and freed gaps between arrays,
/// for later allocations. Must be called once at program start.
inline void keep_freed_memory() {
#ifdef __GLIBC__
    constexpr int kMiB = 1 << 20;
    mallopt(M_MMAP_THRESHOLD, 128 * kMiB);
    mallopt(M_TRIM_THRESHOLD, 256 * kMiB);
    mallopt(M_TOP_PAD, 32 * kMiB);
#endif
}

/// Returns freed memory to the system. Called before a stage that allocates other memory,
/// for example on a device that shares the memory of the host.
inline void give_back_freed_memory() {
#ifdef __GLIBC__
    malloc_trim(0);
#endif
}

}  // namespace relidar::cli
