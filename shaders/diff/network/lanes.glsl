// SPDX-License-Identifier: Apache-2.0
// Moves columns between neighbouring lanes of a subgroup. Include this file after the
// constant LANES, which is the size of the subgroup.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL

/// Returns `a` of the lane k positions after this lane. Beyond the last lane, returns `b`
/// of the first lanes.
float from_lane(float a, float b, uint k) {
    uint lane = gl_SubgroupInvocationID + k;
    float of_a = subgroupShuffle(a, lane % LANES), of_b = subgroupShuffle(b, lane % LANES);
    return lane < LANES ? of_a : of_b;
}
#endif
