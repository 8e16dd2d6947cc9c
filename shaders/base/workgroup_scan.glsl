// SPDX-License-Identifier: Apache-2.0
// Prefix sums over a workgroup of at most 64 subgroups. A shader must assign its elements
// to threads by ordered_thread().
#ifndef RELIDAR_INCLUDED_BASE_WORKGROUP_SCAN_GLSL
#define RELIDAR_INCLUDED_BASE_WORKGROUP_SCAN_GLSL
shared uvec2 scan_sums[64];

/// Returns the index of this thread in the workgroup, numbered subgroup by subgroup, so
/// that prefix sums are the same in every run.
uint ordered_thread() { return gl_SubgroupID * gl_SubgroupSize + gl_SubgroupInvocationID; }

/// Returns the sum over all subgroups before this subgroup. Every thread of the workgroup
/// must call this function.
/// @param sum sum of this subgroup
/// @param total output: sum of all subgroups
uvec2 earlier_sum(uvec2 sum, out uvec2 total) {
    if (subgroupElect()) scan_sums[gl_SubgroupID] = sum;
    barrier();
    total = uvec2(0u);
    uvec2 before = uvec2(0u);
    for (uint first = 0u; first < gl_NumSubgroups; first += gl_SubgroupSize) {
        uint s = first + gl_SubgroupInvocationID;
        uvec2 of_subgroup = s < gl_NumSubgroups ? scan_sums[s] : uvec2(0u);
        total += subgroupAdd(of_subgroup);
        before += subgroupAdd(s < gl_SubgroupID ? of_subgroup : uvec2(0u));
    }
    barrier();
    return before;
}

/// Returns the sum of `value` over all threads before this thread. Every thread of the
/// workgroup must call this function.
/// @param total output: sum over all threads
uvec2 exclusive_sum(uvec2 value, out uvec2 total) {
    uvec2 before = subgroupExclusiveAdd(value);
    return before + earlier_sum(subgroupAdd(value), total);
}
#endif
