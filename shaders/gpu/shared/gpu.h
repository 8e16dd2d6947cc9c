// SPDX-License-Identifier: Apache-2.0
// Parameters of general-purpose kernels: prefix sums, a stable radix sort, a memory copy
// and device checks. Prefix sums and sorts give the same result in every run. A workgroup
// of 256 threads processes a tile of 4096 elements.
#ifndef RELIDAR_INCLUDED_GPU_SHARED_GPU_H
#define RELIDAR_INCLUDED_GPU_SHARED_GPU_H
#include "relidar/base/lang.h"

RELIDAR_SHARED_BEGIN

#define RELIDAR_TILE_THREADS 256u
#define RELIDAR_TILE_SIZE 4096u
#define RELIDAR_SORT_BITS 8u      // Bits of a digit.
#define RELIDAR_SORT_DIGITS 256u  // Number of values of a digit. One thread processes one value.

struct ScanParams {
    RELIDAR_OF(Uints, ScanCounts) counts;  // Input: element i is counts[offset + i * stride].
    // Sum of the counts in each tile [tiles], written by kernel scan_sums. The sums are
    // then replaced by their prefix sums, which kernel scan_write reads. The address is 0
    // if the input has only one tile.
    RELIDAR_OF(Uints, ScanTileSums) tile_sums;
    // Output [n]: prefix sums. May be the same array as `counts` if `stride` is 1.
    RELIDAR_OF(Uints, ScanPrefix) prefix;
    // Output [1]: sum of all counts. Not written if the address is 0.
    RELIDAR_OF(Uints, ScanTotal) total;
    uint n;
    uint offset;
    uint stride;
};

/// Parameters of one pass of a stable radix sort. Each pass sorts by one digit of the
/// keys.
struct RadixSortParams {
    // Input: number of keys [1]. The kernel clamps the number to the capacity. Address 0
    // means that the number equals the capacity.
    RELIDAR_OF(Uints, SortCount) n_keys;
    RELIDAR_OF(Uints, SortKeys) keys;  // Input: keys, [n,KEY_WORDS], low word first.
    // Input [n]: original index of each key. If the address is 0, the original index of
    // key i is i.
    RELIDAR_OF(Uints, SortOrder) order;
    RELIDAR_OF(Uints, SortKeys) sorted_keys;    // Output: sorted keys.
    RELIDAR_OF(Uints, SortOrder) sorted_order;  // Output: original indices of the sorted keys.
    // Radix sort: number of keys with each digit value in each tile of keys,
    // [digits,tiles]. Kernel radix_scan replaces these numbers by their sums over all
    // earlier tiles.
    RELIDAR_OF(Uints, DigitCounts) counts;
    RELIDAR_OF(Uints, DigitTotals) totals;  // Number of keys with each digit, [digits].
    uint capacity;
    uint shift;  // Bit position of the digit, a multiple of RELIDAR_SORT_BITS.
};

struct CopyParams {
    RELIDAR_OF(Vec4s, CopySource) from;  // Input: source vectors, [n].
    RELIDAR_OF(Vec4s, CopyTarget) to;    // Output: copied vectors, [n].
    uint n;
};

#define RELIDAR_CHECK_AMOUNTS 7u   // Number of different values that check_atomics adds.
#define RELIDAR_CHECK_RESULTS 11u  // Results per thread of check_subgroups.

struct CheckAtomicsParams {
    Floats sums;  // Accumulated: thread i adds 1 + i % RELIDAR_CHECK_AMOUNTS to sum i % n_sums.
    uint n;
    uint n_sums;
    uint fault;  // 1: adds without atomics, so that a test can provoke wrong sums.
};

struct CheckSubgroupsParams {
    Uints results;  // Output, [threads,RELIDAR_CHECK_RESULTS].
    uint fault;     // 1: one lane adds nothing, so that a test can provoke a wrong sum.
};

/// Returns the test value of a thread in kernel check_subgroups: a hash below 65536.
RELIDAR_FUNCTION uint test_value(uint thread_index) {
    uint x = thread_index * 747796405u + 2891336453u;
    return (x ^ (x >> 15u)) >> 16u;
}

RELIDAR_SHARED_END
#endif
