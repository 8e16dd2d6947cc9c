// SPDX-License-Identifier: Apache-2.0
// Building blocks that know nothing of rays or surfels: prefix sums, a stable radix sort,
// a copy. Sums and sort give the same result in every run; their workgroups have 256
// threads and take a tile of 4096 elements each.
#ifndef RELIDAR_INCLUDED_GPU_SHARED_GPU_H
#define RELIDAR_INCLUDED_GPU_SHARED_GPU_H
#include "relidar/base/lang.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_TILE_THREADS 256u
#define RELIDAR_TILE_SIZE 4096u
#define RELIDAR_SORT_BITS 8u      // of a digit
#define RELIDAR_SORT_DIGITS 256u  // values of a digit, each the business of one thread

/// Exclusive prefix sum (gpu/scan_sums.comp, scan_write.comp).
struct ScanParams {
    RELIDAR_OF(Uints, ScanCounts) counts;  // input: element i is counts[offset + i * stride]
    // scan_sums: output [tiles]; scan_write: input, prefix sums of them, or address 0 =
    // one tile
    RELIDAR_OF(Uints, ScanTileSums) tile_sums;
    RELIDAR_OF(Uints, ScanPrefix) prefix;  // output [n] of scan_write; may be `counts` where stride is 1
    RELIDAR_OF(Uints, ScanTotal) total;    // output [1] of scan_write: sum of all; address 0 = not wanted
    uint n;
    uint offset;
    uint stride;
};

/// One pass of a stable sort by a digit (gpu/radix_count.comp, radix_scan.comp,
/// radix_scatter.comp).
struct RadixSortParams {
    // input [1]: how many there are, at most capacity count; address 0 = capacity
    RELIDAR_OF(Uints, SortCount) n_keys;
    RELIDAR_OF(Uints, SortKeys) keys;           // input [n,KEY_WORDS] low word first
    RELIDAR_OF(Uints, SortOrder) order;         // input [n], or address 0 = 0, 1, 2, ...
    RELIDAR_OF(Uints, SortKeys) sorted_keys;    // output
    RELIDAR_OF(Uints, SortOrder) sorted_order;  // output
    // [digits,tiles] keys of a digit in a tile; after radix_scan: those in the tiles
    // before
    RELIDAR_OF(Uints, DigitCounts) counts;
    RELIDAR_OF(Uints, DigitTotals) totals;  // [digits] keys of a digit
    uint capacity;
    uint shift;  // of the digit, a multiple of RELIDAR_SORT_BITS
};

/// A copy whose time is taken (gpu/copy.comp).
struct CopyParams {
    RELIDAR_OF(Vec4s, CopySource) from;  // input [n]
    RELIDAR_OF(Vec4s, CopyTarget) to;    // output [n]
    uint n;
};

RELIDAR_SHARED_END
#endif
