// SPDX-License-Identifier: Apache-2.0
#include "bvh_walk.hpp"

#include <bit>
#include <cmath>
#include <cstring>

#include <fmt/format.h>

namespace relidar::test {
namespace {

std::uint32_t unpack_byte(const std::uint32_t* words, int slot) {
    return words[slot / 4] >> (8 * (slot % 4)) & 255u;
}

double decoded(float origin, std::uint32_t exponent, std::uint32_t quantised) {
    const float scale = std::bit_cast<float>(exponent << 23);
    volatile float offset = float(quantised) * scale;  // each step rounded to float
    volatile float x = origin + offset;
    return x;
}

struct TreeCheck {
    const HostBvhCopy& bvh;
    const SurfelModel& model;
    std::vector<int>& node_visit_counts;
    std::vector<int> surfel_visit_counts = {};
    std::string fault = {};

    bool fail(std::string text) {
        if (fault.empty()) fault = std::move(text);
        return false;
    }

    bool leaf(const Slot& slot, HostBox& real) {
        if (slot.count > RELIDAR_BVH_LEAF_SIZE) return fail(fmt::format("a leaf of {} surfels", slot.count));
        if (std::size_t(slot.first) + slot.count > bvh.order.size())
            return fail(fmt::format("leaf entries {} + {} pass the end", slot.first, slot.count));
        for (std::uint32_t k = 0; k < slot.count; ++k) {
            const std::uint32_t surfel = bvh.order[slot.first + k];
            if (surfel >= model.count)
                return fail(fmt::format("surfel {} of a model of {}", surfel, model.count));
            if (++surfel_visit_counts[surfel] > 1)
                return fail(fmt::format("surfel {} is in two leaves", surfel));
            real.add(compute_surfel_box(bvh, model.first + surfel));
        }
        return true;
    }

    bool node(std::uint32_t index, int depth, HostBox& real) {
        if (index >= bvh.nodes.size()) return fail(fmt::format("node {} of {}", index, bvh.nodes.size()));
        if (++node_visit_counts[index] > 1) return fail(fmt::format("node {} is reached twice", index));
        if (depth > 100) return fail("deeper than 100 nodes");
        const std::array<Slot, RELIDAR_BVH_WIDTH> slots = list_slots(bvh.nodes[index]);
        for (int s = 0; s < RELIDAR_BVH_WIDTH; ++s) {
            HostBox below;
            if (!(slots[s].inner ? node(slots[s].child, depth + 1, below) : leaf(slots[s], below)))
                return false;
            const HostBox box = decode_box(bvh.nodes[index], s);
            if (!box.holds(below))
                return fail(fmt::format("slot {} of node {} is smaller than what is in it", s, index));
            if (below.empty() && !box.empty())
                return fail(fmt::format("slot {} of node {} holds nothing and is not inverted", s, index));
            real.add(below);
        }
        return true;
    }
};

}  // namespace

HostBox decode_box(const shared::BvhNode& node, int slot) {
    const std::uint32_t* low[] = {node.low_x, node.low_y, node.low_z};
    const std::uint32_t* high[] = {node.high_x, node.high_y, node.high_z};
    HostBox box;
    for (int c = 0; c < 3; ++c) {
        if (unpack_byte(low[c], slot) > unpack_byte(high[c], slot)) return {};
        const std::uint32_t exponent = node.exponents >> (8 * c) & 255u;
        box.low[c] = decoded(node.origin[c], exponent, unpack_byte(low[c], slot));
        box.high[c] = decoded(node.origin[c], exponent, unpack_byte(high[c], slot));
    }
    return box;
}

HostBox compute_surfel_box(const HostBvhCopy& bvh, std::size_t surfel) {
    HostBox box;
    for (int c = 0; c < 3; ++c) {
        box.low[c] = bvh.boxes[6 * surfel + c];
        box.high[c] = bvh.boxes[6 * surfel + 3 + c];
    }
    return box;
}

std::array<Slot, RELIDAR_BVH_WIDTH> list_slots(const shared::BvhNode& node) {
    std::array<Slot, RELIDAR_BVH_WIDTH> slots;
    std::uint32_t child = node.first_child;
    for (int s = 0; s < RELIDAR_BVH_WIDTH; ++s) {
        const std::uint32_t leaf = unpack_byte(node.leaves, s);
        slots[s].inner = node.exponents >> (24 + s) & 1u;
        if (slots[s].inner) slots[s].child = child++;
        else slots[s] = {false, 0, node.first_leaf + (leaf & 31u), leaf >> 5};
    }
    return slots;
}

std::string find_fault_of_tree(const HostBvhCopy& bvh, std::uint32_t root, const SurfelModel& model,
                               std::vector<int>& visits) {
    TreeCheck check{bvh, model, visits};
    check.surfel_visit_counts.assign(model.count, 0);
    HostBox box;
    if (!check.node(root, 0, box)) return check.fault;
    for (std::uint32_t i = 0; i < model.count; ++i)
        if (check.surfel_visit_counts[i] != 1)
            return fmt::format("surfel {} of {} is in no leaf", i, model.count);
    return "";
}

Scene make_scene_of_sizes(const Surfels& surfels, const std::vector<std::uint32_t>& sizes) {
    Scene scene = wrap_background(surfels);
    scene.models.clear();
    scene.instances.clear();
    std::uint32_t first = 0;
    for (const std::uint32_t size : sizes) {
        scene.instances.push_back({std::uint32_t(scene.models.size()), ""});
        scene.models.push_back({"model " + std::to_string(scene.models.size()), first, size});
        first += size;
    }
    return scene;
}

HostBvhCopy DeviceBvh::build() {
    scene.activate(stream, {}, glm::vec3(0.0f));
    bvh.build_trees(stream, scene, {});
    stream.submit_and_wait();
    return bvh.download_bvh();
}

HostBvhCopy DeviceBvh::refit(const SurfelRanges& ranges) {
    scene.activate(stream, {}, glm::vec3(0.0f));
    bvh.refit_trees(stream, scene, {}, ranges);
    stream.submit_and_wait();
    return bvh.download_bvh();
}

HostBvhCopy DeviceBvh::move(const std::vector<InstancePose>& poses) {
    scene.stage_poses(stream, poses);
    bvh.rebuild_top_level(stream, scene);
    stream.submit_and_wait();
    return bvh.download_bvh();
}

bool are_equal(const std::vector<shared::BvhNode>& a, const std::vector<shared::BvhNode>& b) {
    return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(shared::BvhNode)) == 0;
}

}  // namespace relidar::test
