// SPDX-License-Identifier: Apache-2.0
// Reads values from neighbouring lanes of a subgroup. The constant LANES (size of the
// subgroup) must be defined before this file is included.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL

/// Returns the value `a` of the lane k positions after this lane. If this position is
/// beyond the last lane, returns the value `b` of one of the first lanes.
float from_lane(float a, float b, uint k) {
    uint lane = gl_SubgroupInvocationID + k;
    float of_a = subgroupShuffle(a, lane % LANES), of_b = subgroupShuffle(b, lane % LANES);
    return lane < LANES ? of_a : of_b;
}
#endif
