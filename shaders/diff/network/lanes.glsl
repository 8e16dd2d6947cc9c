// SPDX-License-Identifier: Apache-2.0
// Reads values from neighbouring lanes of a subgroup. The constant LANES (size of the
// subgroup) must be defined before this file is included.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_LANES_GLSL

/// Returns the value `first` of the lane `index` positions after this lane. If this
/// position is beyond the last lane, returns the value `second` of one of the first
/// lanes.
float read_from_lane(float first, float second, uint index) {
    uint lane = gl_SubgroupInvocationID + index;
    float of_a = subgroupShuffle(first, lane % LANES), of_b = subgroupShuffle(second, lane % LANES);
    return lane < LANES ? of_a : of_b;
}
#endif
