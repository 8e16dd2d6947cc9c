// SPDX-License-Identifier: Apache-2.0
// Backend: a two-level tree of wide nodes with quantised boxes (shared/bvh.h) walked with a stack, near children first.
#ifndef RELIDAR_INCLUDED_TRAVERSAL_SOFTWARE_BVH_GLSL
#define RELIDAR_INCLUDED_TRAVERSAL_SOFTWARE_BVH_GLSL
#extension GL_KHR_shader_subgroup_arithmetic : enable
#extension GL_KHR_shader_subgroup_ballot : enable
#extension GL_KHR_shader_subgroup_vote : enable
layout(constant_id = 4) const uint PACKET = 0u;
layout(constant_id = 5) const uint COUNT_VISITS = 0u;

const uint kStackSize = 64u;
const uint kInstanceEntry = 0x80000000u;   // entries of instances; others are nodes

uint stack_entry[kStackSize];
float stack_t[kStackSize];     // where the ray enters it
uint stack_size;

struct WalkRay {
    vec3 origin;
    vec3 inverse;   // of the direction
};

WalkRay walk_ray(vec3 origin, vec3 direction) {
    vec3 d = mix(direction, mix(vec3(-1e-12), vec3(1e-12), greaterThanEqual(direction, vec3(0.0))), lessThan(abs(direction), vec3(1e-12)));
    return WalkRay(origin, 1.0 / d);
}

uint unpack(uint words[2], uint slot) { return (words[slot >> 2u] >> (8u * (slot & 3u))) & 255u; }

uint any_lane(uint mask) { return PACKET != 0u ? subgroupOr(mask) : mask; }

void push_entry(uint entry, float t) {
    stack_entry[stack_size] = entry;
    stack_t[stack_size] = t;
    ++stack_size;
}

void next_hits(TraceScene scene, Ray ray, Key after, float budget) {
    reset_hits(budget);
    float start = search_start(after);
    float end = 1e30;
    WalkRay world = walk_ray(ray.origin, ray.direction);
    WalkRay walk = world;
    bool in_model = false;
    uint floor_size = 0u;   // stack entries that belong to the top tree
    uint instance = 0u;
    stack_size = 0u;
    uint n_nodes = 0u, n_tested = 0u;
    push_entry(0u, start);
    while (stack_size > 0u) {
        --stack_size;
        uint entry = stack_entry[stack_size];
        bool wanted = stack_t[stack_size] <= end;
        if (PACKET != 0u) wanted = subgroupAny(wanted);
        if (!wanted) continue;
        if (in_model && stack_size < floor_size) {
            in_model = false;
            walk = world;
        }
        if ((entry & kInstanceEntry) != 0u) {
            instance = entry & ~kInstanceEntry;
            enter_instance(scene, ray, instance);
            in_model = true;
            floor_size = stack_size;
            walk = walk_ray(entered_origin, entered_direction);
            entry = scene.bvh.roots.at[instance];
            if (entry == RELIDAR_BVH_NO_NODE) continue;
        }
        BvhNodes nodes = in_model ? scene.bvh.nodes : scene.bvh.top_nodes;
        BvhNode node = nodes.at[entry];
        ++n_nodes;
        uint inner = node.exponents >> 24;
        vec3 scale = uintBitsToFloat(uvec3(node.exponents & 255u, (node.exponents >> 8) & 255u, (node.exponents >> 16) & 255u) << 23) * walk.inverse;
        vec3 at = (node.origin - walk.origin) * walk.inverse;
        vec3 pad = 5e-7 * (abs(at) + 255.0 * abs(scale));
        vec3 at_near = at - pad, at_far = at + pad;
        bvec3 backward = lessThan(walk.inverse, vec3(0.0));
        float t[8];
        uint hit = 0u;
        uint near_x[2], near_y[2], near_z[2], far_x[2], far_y[2], far_z[2];
        for (uint w = 0u; w < 2u; ++w) {
            near_x[w] = backward.x ? node.high_x[w] : node.low_x[w];
            far_x[w] = backward.x ? node.low_x[w] : node.high_x[w];
            near_y[w] = backward.y ? node.high_y[w] : node.low_y[w];
            far_y[w] = backward.y ? node.low_y[w] : node.high_y[w];
            near_z[w] = backward.z ? node.high_z[w] : node.low_z[w];
            far_z[w] = backward.z ? node.low_z[w] : node.high_z[w];
        }
        [[unroll]] for (uint slot = 0u; slot < 8u; ++slot) {
            vec3 n = vec3(unpack(near_x, slot), unpack(near_y, slot), unpack(near_z, slot)) * scale + at_near;
            vec3 f = vec3(unpack(far_x, slot), unpack(far_y, slot), unpack(far_z, slot)) * scale + at_far;
            float t0 = max(max(n.x, n.y), max(n.z, start));
            float t1 = min(min(f.x, f.y), min(f.z, end));
            if (!(t0 > t1)) hit |= 1u << slot;
            t[slot] = t0;
        }
        uint opened = any_lane(hit);
        uint leaf_bits = 0u;
        [[unroll]] for (uint slot = 0u; slot < 8u; ++slot) {
            uint leaf = unpack(node.leaves, slot);
            if ((opened & (1u << slot)) != 0u) leaf_bits |= ((1u << (leaf >> 5)) - 1u) << (leaf & 31u);
        }
        if (in_model) {
            while (leaf_bits != 0u) {
                uint i = uint(findLSB(leaf_bits));
                leaf_bits &= leaf_bits - 1u;
                ++n_tested;
                offer(scene, ray, after, instance, scene.bvh.order.at[node.first_leaf + i]);
            }
            if (hits_closed) end = hit_t[n_hits - 1u] + 1e-4 + 1e-5 * hit_t[n_hits - 1u];
        } else {
            while (leaf_bits != 0u) {
                uint i = uint(findLSB(leaf_bits));
                leaf_bits &= leaf_bits - 1u;
                push_entry(kInstanceEntry | scene.bvh.top_order.at[node.first_leaf + i], start);
            }
        }
        uint remaining = opened & inner;
        // farthest first
        while (remaining != 0u) {
            float farthest = -1.0;
            uint chosen = 0u;
            [[unroll]] for (uint slot = 0u; slot < 8u; ++slot) {
                float key = PACKET != 0u ? subgroupBroadcastFirst(t[slot]) : t[slot];
                if ((remaining & (1u << slot)) != 0u && key > farthest) {
                    farthest = key;
                    chosen = slot;
                }
            }
            if (farthest < 0.0) chosen = uint(findLSB(remaining));
            remaining &= ~(1u << chosen);
            float own = t[0];
            [[unroll]] for (uint slot = 1u; slot < 8u; ++slot) own = chosen == slot ? t[slot] : own;
            if ((hit & (1u << chosen)) == 0u) own = 2e30;
            push_entry(node.first_child + bitCount(inner & ((1u << chosen) - 1u)), own);
        }
    }
    if (COUNT_VISITS != 0u) {
        atomicAdd(scene.visits.at[0], n_nodes);
        atomicAdd(scene.visits.at[1], n_tested);
    }
}
#endif
