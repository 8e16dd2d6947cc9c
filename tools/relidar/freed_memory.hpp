// SPDX-License-Identifier: Apache-2.0
// Controls when freed memory is returned to the operating system. Each training stage
// allocates and frees arrays as large as the log. Returning and allocating this memory
// again would take a fifth to a third of the time of a scan registration. The functions
// have an effect only with glibc. The tests set similar limits (GLIBC_TUNABLES in
// CMakePresets.json).
#pragma once

#include <cstddef>  // Any standard header defines __GLIBC__ if the C library is glibc.

#ifdef __GLIBC__
#include <malloc.h>
#endif

namespace relidar::cli {

/// Keeps up to 256 MiB. Must be called once at program start.
inline void keep_freed_memory() {
#ifdef __GLIBC__
    constexpr int kMiB = 1 << 20;
    mallopt(M_MMAP_THRESHOLD, 128 * kMiB);
    mallopt(M_TRIM_THRESHOLD, 256 * kMiB);
    mallopt(M_TOP_PAD, 32 * kMiB);
#endif
}

/// Call it before a stage that needs other memory, for example a GPU that shares it.
inline void release_freed_memory() {
#ifdef __GLIBC__
    malloc_trim(0);
#endif
}

}  // namespace relidar::cli
