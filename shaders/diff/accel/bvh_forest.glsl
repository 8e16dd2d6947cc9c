// SPDX-License-Identifier: Apache-2.0
// Defines bounding boxes, stored as six floats, and coherent buffers for data exchange
// between workgroups of one launch.
#ifndef RELIDAR_INCLUDED_DIFF_ACCEL_BVH_FOREST_GLSL
#define RELIDAR_INCLUDED_DIFF_ACCEL_BVH_FOREST_GLSL

struct Box {
    vec3 low;
    vec3 high;
};

const float BOX_HUGE = 3.402823466e38;
Box make_empty_box() { return Box(vec3(BOX_HUGE), vec3(-BOX_HUGE)); }
bool is_empty(Box box) { return !(box.low.x <= box.high.x); }
Box join_boxes(Box first, Box second) {
    return Box(min(first.low, second.low), max(first.high, second.high));
}

Box load_box(Floats boxes, uint index) {
    return Box(vec3(boxes.at[6 * index], boxes.at[6 * index + 1], boxes.at[6 * index + 2]),
               vec3(boxes.at[6 * index + 3], boxes.at[6 * index + 4], boxes.at[6 * index + 5]));
}

// Pointer types for arrays through which subgroups of one launch exchange values. They
// are coherent, because each core of a GPU may have a separate cache. Other pointer
// types, for example Floats, are not coherent.
layout(buffer_reference, scalar, buffer_reference_align = 4) coherent buffer SharedFloats { float at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) coherent buffer SharedUints { uint at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 8) coherent buffer SharedUvec2s { uvec2 at[]; };

Box load_shared_box(Floats boxes, uint index) {
    SharedFloats b = SharedFloats(uvec2(boxes));
    return Box(vec3(b.at[6 * index], b.at[6 * index + 1], b.at[6 * index + 2]),
               vec3(b.at[6 * index + 3], b.at[6 * index + 4], b.at[6 * index + 5]));
}
void store_box(Floats boxes, uint index, Box value) {
    SharedFloats b = SharedFloats(uvec2(boxes));
    for (uint c = 0u; c < 3u; ++c) {
        b.at[6 * index + c] = value.low[c];
        b.at[6 * index + 3 + c] = value.high[c];
    }
}

// Cost of testing a surfel relative to the cost of visiting a node. A surfel test reads
// 64 B and intersects a plane. A node visit reads 80 B and tests eight boxes.
const float SURFEL_COST = 0.3;

/// Returns half the surface area of a box. Limits each edge to 1e18 m, so that the result
/// is finite.
float half_area(Box box) {
    vec3 e = clamp(box.high - box.low, vec3(0.0), vec3(1e18));
    return e.x * e.y + e.y * e.z + e.z * e.x;
}

/// Maps a float to an unsigned integer with the same order. Integer atomics can then
/// compute minima of floats.
uint to_ordered_bits(float value) {
    uint bits = floatBitsToUint(value);
    return (bits & 0x80000000u) != 0u ? ~bits : bits | 0x80000000u;
}
float from_ordered(uint bits) {
    return uintBitsToFloat((bits & 0x80000000u) != 0u ? bits & 0x7fffffffu : ~bits);
}
#endif
