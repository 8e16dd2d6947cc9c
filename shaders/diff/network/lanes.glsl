// SPDX-License-Identifier: Apache-2.0
// Columns that neighbouring lanes of a subgroup hold. Include after the constant LANES,
// the subgroup's size.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL

/// What the lane k places on holds: of `a`, and past the last lane of `b`.
float from_lane(float a, float b, uint k) {
    uint lane = gl_SubgroupInvocationID + k;
    float of_a = subgroupShuffle(a, lane % LANES), of_b = subgroupShuffle(b, lane % LANES);
    return lane < LANES ? of_a : of_b;
}
#endif
