// SPDX-License-Identifier: Apache-2.0
// Sums values over a workgroup and adds the sum to memory with one atomic operation. One
// atomic operation per thread would be slow, because a GPU executes atomics on the same
// float one after another.
#ifndef RELIDAR_INCLUDED_BASE_REDUCE_GLSL
#define RELIDAR_INCLUDED_BASE_REDUCE_GLSL
#include "relidar/base/atomic_add.glsl"

// The reduction requires a workgroup size that is a power of two.
shared float reduce_partial[gl_WorkGroupSize.x];

/// Adds the values of all threads of the workgroup to sums[entry]. Every thread must call
/// this function. Threads without an element pass 0.
void add_to_sum(Floats sums, uint entry, float value) {
    uint lane = gl_LocalInvocationIndex;
    barrier();  // Waits until all threads have read the previous sum.
    reduce_partial[lane] = value;
    barrier();
    for (uint n = gl_WorkGroupSize.x / 2u; n > 0u; n /= 2u) {
        if (lane < n) reduce_partial[lane] += reduce_partial[lane + n];
        barrier();
    }
    if (lane == 0u && reduce_partial[0] != 0.0) atomic_add(sums, entry, reduce_partial[0]);
}
#endif
