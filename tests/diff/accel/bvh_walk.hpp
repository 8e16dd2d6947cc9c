// SPDX-License-Identifier: Apache-2.0
// Reads the software acceleration structure on the host. Decodes its boxes, and checks
// properties that every tree must have.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "diff/accel/bvh.hpp"

namespace relidar::test {

struct HostBox {
    glm::dvec3 low{HUGE_VAL}, high{-HUGE_VAL};
    bool empty() const { return !(low.x <= high.x); }
    bool holds(const HostBox& inner) const {
        return inner.empty() || (glm::all(glm::lessThanEqual(low, inner.low)) &&
                                 glm::all(glm::lessThanEqual(inner.high, high)));
    }
    void add(const HostBox& b) {
        if (b.empty()) return;
        low = glm::min(low, b.low);
        high = glm::max(high, b.high);
    }
};

/// Decodes the box of a child of a node with the same float arithmetic as the traversal
/// on the device.
HostBox decode_box(const shared::BvhNode& node, int slot);
HostBox compute_surfel_box(const HostBvhCopy& bvh, std::size_t surfel);

struct Slot {
    bool inner = false;
    std::uint32_t child = 0;  ///< child node of an inner slot
    /// Range of `order` with the surfels of a leaf slot. If the count is 0, the slot is
    /// empty or an inner node.
    std::uint32_t first = 0, count = 0;
};
std::array<Slot, RELIDAR_BVH_WIDTH> list_slots(const shared::BvhNode& node);

/// Returns the first error in the tree of a model, or an empty string. Each surfel must
/// be in a single leaf, and each box must be inside the box of its parent. All indices
/// must be within their arrays, and each node must be reached once.
/// @param visits [nodes] counts visits to each node, over all models
std::string find_fault_of_tree(const HostBvhCopy& bvh, std::uint32_t root, const SurfelModel& model,
                               std::vector<int>& visits);

/// Returns a scene with a model and an instance for each consecutive range of surfels.
Scene make_scene_of_sizes(const Surfels& surfels, const std::vector<std::uint32_t>& sizes);

/// Scene on the device with its trees.
struct DeviceBvh {
    DeviceScene scene;
    Bvh bvh;
    Stream stream;

    DeviceBvh(Device& device, const Scene& s) : scene(device, s), bvh(device, scene), stream(device) {}
    HostBvhCopy build();
    HostBvhCopy refit(const SurfelRanges& ranges);
    HostBvhCopy move(const std::vector<InstancePose>& poses);
};

bool are_equal(const std::vector<shared::BvhNode>& a, const std::vector<shared::BvhNode>& b);

}  // namespace relidar::test
