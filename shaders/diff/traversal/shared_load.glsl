// SPDX-License-Identifier: Apache-2.0
// Loads a struct once for all lanes of a subgroup. Each lane loads a different word, and
// shuffles distribute the words. With a normal load, a CPU loads each word once per lane,
// even if all addresses are equal. A node of 20 words then takes 20 gather instructions,
// but only 3 with this method on 8 lanes. All lanes must be active and must not diverge.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_SHARED_LOAD_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_SHARED_LOAD_GLSL

// Sizes of BvhNode and SurfelRecord in 32-bit words. Word k is at the offset 4 k of the
// struct.
const uint kNodeWords = 20u, kRecordWords = 16u;
// Maximum number of words that one lane loads: the 20 words of a tree node divided by the
// minimum subgroup size, 4.
const uint kMostParts = 5u;

/// 32-bit words of a struct, distributed over the n lanes of a subgroup. Word k is
/// part[k / n] of lane k % n.
struct SharedWords {
    uint part[kMostParts];
};

/// Loads `count` words of a struct. Each lane of the subgroup loads different words.
/// @param source,first,count must be equal in all lanes
SharedWords load_words(Uints source, uint first, uint count) {
    SharedWords words;
    [[unroll]] for (uint p = 0u; p < kMostParts; ++p) {
        words.part[p] = 0u;
        if (p * gl_SubgroupSize < count)
            words.part[p] = source.at[first + min(p * gl_SubgroupSize + gl_SubgroupInvocationID, count - 1u)];
    }
    return words;
}

/// Returns word `index` of a struct. `index` must be equal in all lanes of the subgroup.
uint broadcast_word(SharedWords words, uint index) {
    uint part = words.part[0];
    [[unroll]] for (uint p = 1u; p < kMostParts; ++p) if (index >= p * gl_SubgroupSize) part = words.part[p];
    return subgroupShuffle(part, index % gl_SubgroupSize);
}

vec3 get_vec3(SharedWords words, uint index) {
    return uintBitsToFloat(uvec3(broadcast_word(words, index), broadcast_word(words, index + 1u),
                                 broadcast_word(words, index + 2u)));
}

/// Loads one node for all lanes. The numbers are the positions of the fields in words.
BvhNode load_node(BvhNodes nodes, uint index) {
    SharedWords words = load_words(Uints(uvec2(nodes)), index * kNodeWords, kNodeWords);
    BvhNode node;
    node.origin = get_vec3(words, 0u);
    node.exponents = broadcast_word(words, 3u);
    node.first_child = broadcast_word(words, 4u);
    node.first_leaf = broadcast_word(words, 5u);
    [[unroll]] for (uint k = 0u; k < 2u; ++k) {
        node.leaves[k] = broadcast_word(words, 6u + k);
        node.low_x[k] = broadcast_word(words, 8u + k);
        node.low_y[k] = broadcast_word(words, 10u + k);
        node.low_z[k] = broadcast_word(words, 12u + k);
        node.high_x[k] = broadcast_word(words, 14u + k);
        node.high_y[k] = broadcast_word(words, 16u + k);
        node.high_z[k] = broadcast_word(words, 18u + k);
    }
    return node;
}

/// Loads a surfel for all lanes of the subgroup. Each lane loads some words. Fills only
/// the fields that intersect() reads.
SurfelRecord load_record(Records records, uint surfel) {
    SharedWords words = load_words(Uints(uvec2(records)), surfel * kRecordWords, kRecordWords);
    SurfelRecord record;
    record.mean = get_vec3(words, 0u);
    record.opacity = uintBitsToFloat(broadcast_word(words, 3u));
    record.axis_u = get_vec3(words, 4u);
    record.axis_v = get_vec3(words, 8u);
    record.normal = get_vec3(words, 12u);
    return record;
}
#endif
