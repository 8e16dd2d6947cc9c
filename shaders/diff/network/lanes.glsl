// SPDX-License-Identifier: Apache-2.0
// Reads values from neighbouring lanes of a subgroup. The constant LANES (size of the
// subgroup) must be defined before this file is included.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL

/// Returns `first` of lane number n = (number of this lane + index). If n is at least
/// LANES, returns `second` of lane n - LANES instead.
float read_from_lane(float first, float second, uint index) {
    uint lane = gl_SubgroupInvocationID + index;
    float of_a = subgroupShuffle(first, lane % LANES), of_b = subgroupShuffle(second, lane % LANES);
    return lane < LANES ? of_a : of_b;
}
#endif
