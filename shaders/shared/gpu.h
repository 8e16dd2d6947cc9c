// SPDX-License-Identifier: Apache-2.0
// Building blocks that know nothing of rays or surfels: prefix sums and a stable radix sort. Both give the same result in every run.
// Their workgroups have 256 threads and take a tile of 4096 elements each.
#ifndef RELIDAR_INCLUDED_SHARED_GPU_H
#define RELIDAR_INCLUDED_SHARED_GPU_H
#include "relidar/shared/lang.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_TILE_THREADS 256u
#define RELIDAR_TILE_SIZE 4096u
#define RELIDAR_SORT_BITS 8u        // of a digit
#define RELIDAR_SORT_DIGITS 256u    // values of a digit, each the business of one thread

/// Exclusive prefix sum (gpu/scan_sums.comp, scan_write.comp).
struct ScanParams {
    Uints counts;       // input: element i is counts[offset + i * stride]
    Uints tile_sums;    // scan_sums: output [tiles]; scan_write: input, prefix sums of them, or address 0 = one tile
    Uints prefix;       // output [n] of scan_write; may be `counts` where stride is 1
    Uints total;        // output [1] of scan_write: sum of all; address 0 = not wanted
    uint n;
    uint offset;
    uint stride;
};

/// One pass of a stable sort by a digit (gpu/radix_count.comp, radix_scan.comp, radix_scatter.comp).
struct RadixSortParams {
    Uints n_keys;         // input [1]: how many there are, at most capacity count; address 0 = capacity
    Uints keys;           // input [n,KEY_WORDS] low word first
    Uints order;          // input [n], or address 0 = 0, 1, 2, ...
    Uints sorted_keys;    // output
    Uints sorted_order;   // output
    Uints counts;         // [digits,tiles] keys of a digit in a tile; after radix_scan: those in the tiles before
    Uints totals;         // [digits] keys of a digit
    uint capacity;
    uint shift;           // of the digit, a multiple of RELIDAR_SORT_BITS
};

RELIDAR_SHARED_END
#endif
