// SPDX-License-Identifier: Apache-2.0
// What all lanes of a subgroup read from one address, loaded by them together: each loads
// another word of it and hands it to the others. A CPU gathers lane by lane even where
// all addresses are the same: a node of 20 words then costs 20 gathers, and 3 in this way
// with 8 lanes. All lanes must be there, and must not part.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_SHARED_LOAD_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_SHARED_LOAD_GLSL

// of BvhNode and SurfelRecord, whose words are in the order of their declaration
const uint kNodeWords = 20u, kRecordWords = 16u;
const uint kMostParts = 5u;  // of a node among 4 lanes, the smallest subgroup

/// Words of a struct: lane k % size of the subgroup holds word k in part k / size.
struct SharedWords {
    uint part[kMostParts];
};

/// @param from,first,n  the same in all lanes
SharedWords load_words(Uints from, uint first, uint n) {
    SharedWords words;
    [[unroll]] for (uint p = 0u; p < kMostParts; ++p) {
        words.part[p] = 0u;
        if (p * gl_SubgroupSize < n)
            words.part[p] = from.at[first + min(p * gl_SubgroupSize + gl_SubgroupInvocationID, n - 1u)];
    }
    return words;
}

/// @param k  the same in all lanes
uint word_of(SharedWords words, uint k) {
    uint part = words.part[0];
    [[unroll]] for (uint p = 1u; p < kMostParts; ++p) if (k >= p * gl_SubgroupSize) part = words.part[p];
    return subgroupShuffle(part, k % gl_SubgroupSize);
}

vec3 vec3_of(SharedWords words, uint k) {
    return uintBitsToFloat(uvec3(word_of(words, k), word_of(words, k + 1u), word_of(words, k + 2u)));
}

BvhNode load_node(BvhNodes nodes, uint index) {
    SharedWords words = load_words(Uints(uvec2(nodes)), index * kNodeWords, kNodeWords);
    BvhNode node;
    node.origin = vec3_of(words, 0u);
    node.exponents = word_of(words, 3u);
    node.first_child = word_of(words, 4u);
    node.first_leaf = word_of(words, 5u);
    [[unroll]] for (uint k = 0u; k < 2u; ++k) {
        node.leaves[k] = word_of(words, 6u + k);
        node.low_x[k] = word_of(words, 8u + k);
        node.low_y[k] = word_of(words, 10u + k);
        node.low_z[k] = word_of(words, 12u + k);
        node.high_x[k] = word_of(words, 14u + k);
        node.high_y[k] = word_of(words, 16u + k);
        node.high_z[k] = word_of(words, 18u + k);
    }
    return node;
}

/// A record as far as intersect() reads it.
SurfelRecord load_record(Records records, uint surfel) {
    SharedWords words = load_words(Uints(uvec2(records)), surfel * kRecordWords, kRecordWords);
    SurfelRecord record;
    record.mean = vec3_of(words, 0u);
    record.opacity = uintBitsToFloat(word_of(words, 3u));
    record.axis_u = vec3_of(words, 4u);
    record.axis_v = vec3_of(words, 8u);
    record.normal = vec3_of(words, 12u);
    return record;
}
#endif
