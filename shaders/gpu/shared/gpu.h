// SPDX-License-Identifier: Apache-2.0
// Parameters of general-purpose kernels: prefix sums, a stable radix sort and a copy.
// Sums and sort give the same result in every run. Their workgroups have 256 threads and
// process a tile of 4096 elements each.
#ifndef RELIDAR_INCLUDED_GPU_SHARED_GPU_H
#define RELIDAR_INCLUDED_GPU_SHARED_GPU_H
#include "relidar/base/lang.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_TILE_THREADS 256u
#define RELIDAR_TILE_SIZE 4096u
#define RELIDAR_SORT_BITS 8u      // Bits of a digit.
#define RELIDAR_SORT_DIGITS 256u  // Number of values of a digit; each is handled by one thread.

/// Exclusive prefix sum (gpu/scan_sums.comp, scan_write.comp).
struct ScanParams {
    RELIDAR_OF(Uints, ScanCounts) counts;  // Input: element i is counts[offset + i * stride].
    // Sums of the tiles, [tiles]: output of scan_sums. Input of scan_write as prefix
    // sums; address 0 = one tile.
    RELIDAR_OF(Uints, ScanTileSums) tile_sums;
    RELIDAR_OF(Uints, ScanPrefix) prefix;  // Output of scan_write, [n]; may be `counts` if stride is 1.
    RELIDAR_OF(Uints, ScanTotal) total;    // Output of scan_write, [1]: total sum; address 0 = not needed.
    uint n;
    uint offset;
    uint stride;
};

/// Pass of a stable sort by a digit (gpu/radix_count.comp, radix_scan.comp,
/// radix_scatter.comp).
struct RadixSortParams {
    // Input, [1]: number of keys, limited by the capacity; address 0 = capacity.
    RELIDAR_OF(Uints, SortCount) n_keys;
    RELIDAR_OF(Uints, SortKeys) keys;           // Input: keys, [n,KEY_WORDS], low word first.
    RELIDAR_OF(Uints, SortOrder) order;         // Input: original indices, [n]; address 0 = 0, 1, 2, ...
    RELIDAR_OF(Uints, SortKeys) sorted_keys;    // Output: sorted keys.
    RELIDAR_OF(Uints, SortOrder) sorted_order;  // Output: original indices of the sorted keys.
    // Number of keys with each digit in each tile, [digits,tiles]; after radix_scan the
    // number in all earlier tiles.
    RELIDAR_OF(Uints, DigitCounts) counts;
    RELIDAR_OF(Uints, DigitTotals) totals;  // Number of keys with each digit, [digits].
    uint capacity;
    uint shift;  // Bit position of the digit, a multiple of RELIDAR_SORT_BITS.
};

/// Copy for bandwidth measurements (gpu/copy.comp).
struct CopyParams {
    RELIDAR_OF(Vec4s, CopySource) from;  // Input: source vectors, [n].
    RELIDAR_OF(Vec4s, CopyTarget) to;    // Output: copied vectors, [n].
    uint n;
};

RELIDAR_SHARED_END
#endif
