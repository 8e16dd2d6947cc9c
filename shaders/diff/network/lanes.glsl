// SPDX-License-Identifier: Apache-2.0
// Reads values from neighbouring lanes of a subgroup. The constant LANES (size of the
// subgroup) must be defined before this file is included.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL

/// Returns `value` of lane number n = (number of this lane + lane_offset). If n is at
/// least LANES, returns `next_block_value` of lane n - LANES instead.
float read_lane(float value, float next_block_value, uint lane_offset) {
    uint lane = gl_SubgroupInvocationID + lane_offset;
    float of_a = subgroupShuffle(value, lane % LANES), of_b = subgroupShuffle(next_block_value, lane % LANES);
    return lane < LANES ? of_a : of_b;
}
#endif
