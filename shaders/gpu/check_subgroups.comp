// SPDX-License-Identifier: Apache-2.0
// Writes the results of subgroup operations, so that the host can check them. The value
// of a thread depends only on ordered_thread(), so the host knows all
// correct results. Output: results.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../base/kernel.glsl"
#include "../base/workgroup_scan.glsl"
#include "shared/gpu.h"
RELIDAR_PARAMS(CheckSubgroupsParams);

void main() {
    uint lane = gl_SubgroupInvocationID, thread = ordered_thread();
    uint global = workgroup_index() * gl_WorkGroupSize.x + thread;
    uint x = test_value(global);
    bool odd = (x & 1u) != 0u;
    uint first = global * RELIDAR_CHECK_RESULTS;
    uint sum = subgroupAdd(params.fault != 0u && lane == 0u ? 0u : x);
    uvec2 total, before = exclusive_sum(uvec2(x, 1u), total);
    uvec4 ballot = subgroupBallot(odd);
    params.results.at[first] = gl_SubgroupSize;
    params.results.at[first + 1u] = sum;
    params.results.at[first + 2u] = subgroupExclusiveAdd(x);
    params.results.at[first + 3u] = subgroupMax(x);
    params.results.at[first + 4u] = subgroupBallotBitCount(ballot);
    params.results.at[first + 5u] = subgroupShuffle(x, lane ^ 1u);
    params.results.at[first + 6u] = uint(subgroupAny(odd)) + 2u * uint(subgroupAll(odd));
    params.results.at[first + 7u] = subgroupBroadcastFirst(x);
    params.results.at[first + 9u] = before.x;
    params.results.at[first + 10u] = total.x;
    uint in_branch = 0u;
    // Half of the lanes take this branch, and the sum must include only these lanes. The
    // branch comes last, because the lanes may not reconverge after it.
    if (odd) in_branch = subgroupAdd(x);
    params.results.at[first + 8u] = in_branch;
}
