// SPDX-License-Identifier: Apache-2.0
// Exchange of columns between neighbouring lanes of a subgroup. Include this file after
// the constant LANES, the size of the subgroup.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL

/// Returns the value of `a` in the lane k positions further. Beyond the last lane,
/// continues with `b` of the first lanes.
float from_lane(float a, float b, uint k) {
    uint lane = gl_SubgroupInvocationID + k;
    float of_a = subgroupShuffle(a, lane % LANES), of_b = subgroupShuffle(b, lane % LANES);
    return lane < LANES ? of_a : of_b;
}
#endif
