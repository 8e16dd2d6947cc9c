// SPDX-License-Identifier: Apache-2.0
// Boxes of a wide node, rounded outward: what a traversal decodes, origin + q 2^(e - 127) in float arithmetic, holds the real box.
#ifndef RELIDAR_INCLUDED_ACCEL_BVH_NODE_GLSL
#define RELIDAR_INCLUDED_ACCEL_BVH_NODE_GLSL

float decoded(float origin, uint q, float scale) {
    precise float offset = float(q) * scale;   // exact: 8 bits times a power of two
    precise float x = origin + offset;
    return x;
}

/// Least exponent with which 255 steps reach from low to high. Scales are normal floats: 2^-126 ... 2^126.
uint exponent_for(float low, float high) {
    uint bits = floatBitsToUint((high - low) / 255.0);
    uint e = clamp((bits >> 23) + ((bits & 0x7fffffu) != 0u ? 1u : 0u), 1u, 253u);
    while (e < 253u && decoded(low, 255u, uintBitsToFloat(e << 23)) < high) ++e;
    return e;
}

/// Steps of the low and the high side of a child along an axis, in bits 0-7 and 8-15.
uint quantised(float origin, uint e, float low, float high) {
    float scale = uintBitsToFloat(e << 23), steps = uintBitsToFloat((254u - e) << 23);
    uint q_low = uint(clamp(floor((low - origin) * steps), 0.0, 255.0));
    uint q_high = uint(clamp(ceil((high - origin) * steps), 0.0, 255.0));
    while (q_low > 0u && decoded(origin, q_low, scale) > low) --q_low;
    while (q_high < 255u && decoded(origin, q_high, scale) < high) ++q_high;
    return q_low | q_high << 8;
}

/// Writes origin, exponents (the inner mask stays as given) and child boxes.
/// @return the node's own box
Box write_boxes(BvhNodes nodes, uint node, uint inner_mask, Box children[RELIDAR_BVH_WIDTH]) {
    Box whole = empty_box();
    for (uint s = 0u; s < RELIDAR_BVH_WIDTH; ++s) whole = joined(whole, children[s]);
    Box frame = is_empty(whole) ? Box(vec3(0.0), vec3(0.0)) : whole;
    uvec3 e =
        uvec3(exponent_for(frame.low.x, frame.high.x), exponent_for(frame.low.y, frame.high.y), exponent_for(frame.low.z, frame.high.z));
    uvec3 low[2] = uvec3[](uvec3(0u), uvec3(0u)), high[2] = uvec3[](uvec3(0u), uvec3(0u));
    for (uint s = 0u; s < RELIDAR_BVH_WIDTH; ++s) {
        Box b = children[s];
        uvec3 q = uvec3(255u);   // inverted
        if (!is_empty(b))
            q = uvec3(quantised(frame.low.x, e.x, b.low.x, b.high.x), quantised(frame.low.y, e.y, b.low.y, b.high.y),
                      quantised(frame.low.z, e.z, b.low.z, b.high.z));
        low[s / 4u] |= (q & 255u) << (8u * (s % 4u));
        high[s / 4u] |= (q >> 8) << (8u * (s % 4u));
    }
    nodes.at[node].origin = frame.low;
    nodes.at[node].exponents = e.x | e.y << 8 | e.z << 16 | inner_mask << 24;
    for (uint w = 0u; w < 2u; ++w) {
        nodes.at[node].low_x[w] = low[w].x;
        nodes.at[node].low_y[w] = low[w].y;
        nodes.at[node].low_z[w] = low[w].z;
        nodes.at[node].high_x[w] = high[w].x;
        nodes.at[node].high_y[w] = high[w].y;
        nodes.at[node].high_z[w] = high[w].z;
    }
    return whole;
}
#endif
