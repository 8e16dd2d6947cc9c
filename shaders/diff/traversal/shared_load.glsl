// SPDX-License-Identifier: Apache-2.0
// Loads a struct once for all lanes of a subgroup. Each lane loads a different word, and
// shuffles distribute the words. On a CPU, a normal load repeats for each lane, even if
// all addresses are equal. A node of 20 words then takes 20 gather instructions, but only
// 3 with this method on 8 lanes. All lanes must be active and must not diverge.
#ifndef RELIDAR_INCLUDED_DIFF_TRAVERSAL_SHARED_LOAD_GLSL
#define RELIDAR_INCLUDED_DIFF_TRAVERSAL_SHARED_LOAD_GLSL

// Sizes of BvhNode and SurfelRecord in 32-bit words. Words are in the order of the
// declared members.
const uint kNodeWords = 20u, kRecordWords = 16u;
// Number of loads per node in a subgroup of 4 lanes, the smallest supported subgroup
// size.
const uint kMostParts = 5u;

/// Words of a struct, distributed over the lanes of a subgroup. Word k is in lane k %
/// size, in part k / size.
struct SharedWords {
    uint part[kMostParts];
};

/// Loads n words of a struct. Each lane of the subgroup loads different words.
/// @param from,first,n must be equal in all lanes
SharedWords load_words(Uints from, uint first, uint n) {
    SharedWords words;
    [[unroll]] for (uint p = 0u; p < kMostParts; ++p) {
        words.part[p] = 0u;
        if (p * gl_SubgroupSize < n)
            words.part[p] = from.at[first + min(p * gl_SubgroupSize + gl_SubgroupInvocationID, n - 1u)];
    }
    return words;
}

/// Returns word k of the struct to all lanes.
/// @param k  must be equal in all lanes
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

/// Loads a surfel record. Fills only the fields that intersect() reads.
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
