// SPDX-License-Identifier: Apache-2.0
// Quantises the child boxes of a node to 8 bits per bound, rounded outward. The traversal
// decodes a bound as origin + q 2^(e - 127). The decoded box always contains the exact
// box.
#ifndef RELIDAR_INCLUDED_DIFF_ACCEL_BVH_NODE_GLSL
#define RELIDAR_INCLUDED_DIFF_ACCEL_BVH_NODE_GLSL

/// Returns the bound that the traversal computes from a quantised value.
float decode_bound(float origin, uint quantised, float scale) {
    precise float offset = float(quantised) * scale;  // exact: an 8-bit integer times a power of two
    precise float x = origin + offset;
    return x;
}

/// Returns the smallest exponent e for which 255 steps of size 2^(e - 127) cover the
/// interval from low to high.
uint grid_exponent(float low, float high) {
    uint bits = floatBitsToUint((high - low) / 255.0);
    uint e = clamp((bits >> 23) + ((bits & 0x7fffffu) != 0u ? 1u : 0u), 1u, 253u);
    while (e < 253u && decode_bound(low, 255u, uintBitsToFloat(e << 23)) < high) ++e;
    return e;
}

/// Quantises the lower and the upper bound of a child box along one axis. Returns the
/// lower bound in bits 0-7 and the upper bound in bits 8-15.
uint quantise(float origin, uint exponent, float low, float high) {
    float scale = uintBitsToFloat(exponent << 23), steps = uintBitsToFloat((254u - exponent) << 23);
    uint q_low = uint(clamp(floor((low - origin) * steps), 0.0, 255.0));
    uint q_high = uint(clamp(ceil((high - origin) * steps), 0.0, 255.0));
    // Corrects rounding errors with the same arithmetic as the traversal, so that the
    // decoded box contains the exact box.
    while (q_low > 0u && decode_bound(origin, q_low, scale) > low) --q_low;
    while (q_high < 255u && decode_bound(origin, q_high, scale) < high) ++q_high;
    return q_low | q_high << 8;
}

struct NodeGrid {
    vec3 origin;
    uvec3 exponents;
};

/// Returns the grid to which the child boxes of a node are quantised.
/// @param bounds bounding box of the node
NodeGrid make_node_grid(Box bounds) {
    Box frame = is_empty(bounds) ? Box(vec3(0.0), vec3(0.0)) : bounds;
    return NodeGrid(frame.low,
                    uvec3(grid_exponent(frame.low.x, frame.high.x), grid_exponent(frame.low.y, frame.high.y),
                          grid_exponent(frame.low.z, frame.high.z)));
}

/// Quantises the box of a child along all three axes. Each component has the lower bound
/// in bits 0-7 and the upper bound in bits 8-15. An empty child gets an inverted box (low
/// above high), which no ray hits.
uvec3 quantise_box(NodeGrid grid, Box child) {
    if (is_empty(child)) return uvec3(255u);
    return uvec3(quantise(grid.origin.x, grid.exponents.x, child.low.x, child.high.x),
                 quantise(grid.origin.y, grid.exponents.y, child.low.y, child.high.y),
                 quantise(grid.origin.z, grid.exponents.z, child.low.z, child.high.z));
}

void store_grid(BvhNodes nodes, uint node, NodeGrid grid, uint inner_child_mask) {
    nodes.at[node].origin = grid.origin;
    nodes.at[node].exponents =
        grid.exponents.x | grid.exponents.y << 8 | grid.exponents.z << 16 | inner_child_mask << 24;
}

/// Writes the bounds of four child boxes to a node. Each bound is one byte.
/// @param child_word 0 for children 0 to 3, 1 for children 4 to 7
void write_four_bounds(BvhNodes nodes, uint node, uint child_word, uvec3 low, uvec3 high) {
    nodes.at[node].low_x[child_word] = low.x;
    nodes.at[node].low_y[child_word] = low.y;
    nodes.at[node].low_z[child_word] = low.z;
    nodes.at[node].high_x[child_word] = high.x;
    nodes.at[node].high_y[child_word] = high.y;
    nodes.at[node].high_z[child_word] = high.z;
}

/// Writes the quantised child boxes of a node.
/// @param inner_child_mask bit mask of the children that are nodes, not leaves
/// @return bounding box of all children
Box write_child_boxes(BvhNodes nodes, uint node, uint inner_child_mask, Box children[RELIDAR_BVH_WIDTH]) {
    Box bounds = make_empty_box();
    for (uint s = 0u; s < RELIDAR_BVH_WIDTH; ++s) bounds = join_boxes(bounds, children[s]);
    NodeGrid grid = make_node_grid(bounds);
    uvec3 low[2] = uvec3[](uvec3(0u), uvec3(0u)), high[2] = uvec3[](uvec3(0u), uvec3(0u));
    for (uint s = 0u; s < RELIDAR_BVH_WIDTH; ++s) {
        uvec3 steps = quantise_box(grid, children[s]);
        low[s / 4u] |= (steps & 255u) << (8u * (s % 4u));
        high[s / 4u] |= (steps >> 8) << (8u * (s % 4u));
    }
    store_grid(nodes, node, grid, inner_child_mask);
    for (uint word = 0u; word < 2u; ++word) write_four_bounds(nodes, node, word, low[word], high[word]);
    return bounds;
}
#endif
