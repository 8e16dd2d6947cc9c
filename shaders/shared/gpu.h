// SPDX-License-Identifier: Apache-2.0
// Building blocks that know nothing of rays or surfels: prefix sums, a stable radix sort, sums of rows. All of them give the same
// result in every run, and take element counts from the device where the host does not know them.
#ifndef RELIDAR_INCLUDED_SHARED_GPU_H
#define RELIDAR_INCLUDED_SHARED_GPU_H
#include "lang.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_SCAN_BLOCK 256u
#define RELIDAR_SORT_BITS 6u
#define RELIDAR_SORT_DIGITS 64u
#define RELIDAR_SORT_TILE 128u    // keys a thread: a column of RELIDAR_SORT_DIGITS counts for that many

struct ScanParams {
    Uints counts;        // input: element i is counts[offset + i * stride]
    Uints block_sums;    // scan_sums: output [blocks]; scan_write: input, prefix sums of them, or address 0 = one block
    Uints prefix;        // output [n + 1] of scan_write: sum of the elements before i; may be `counts` where stride is 1 (then [n] is not written)
    uint n;
    uint offset;
    uint stride;
};

struct RadixSortParams {
    Uints n_keys;          // input [1]: how many there are, at most capacity count
    Uints keys;            // input
    Uints values;          // input, or address 0 = 0, 1, 2, ...
    Uints sorted_keys;     // output
    Uints sorted_values;   // output
    Uints table;           // [digits,tiles]: counts of radix_count, their prefix sums in radix_scatter
    uint capacity;
    uint n_tiles;          // that hold the capacity
    uint shift;            // of the digit
};

struct SumRowsParams {
    Floats rows;       // input [n,width]
    Floats sums;       // output [n_blocks,width]; added to where accumulate is 1
    uint n;
    uint width;
    uint block;        // rows a block
    uint n_blocks;
    uint accumulate;
};

RELIDAR_SHARED_END
#endif
