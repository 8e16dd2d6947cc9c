// SPDX-License-Identifier: Apache-2.0
// The software acceleration structure on the host: decoded boxes, what holds for every
// tree, and walks along rays.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
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

/// Child box of a node as a traversal decodes it, in float arithmetic.
HostBox decoded_box(const shared::BvhNode& node, int slot);
HostBox surfel_box(const BvhOnHost& bvh, std::size_t surfel);

struct Slot {
    bool inner = false;
    std::uint32_t child = 0;  ///< of an inner slot
    /// entries of `order` of a leaf slot; count 0 and not inner: empty
    std::uint32_t first = 0, count = 0;
};
std::array<Slot, RELIDAR_BVH_WIDTH> slots_of(const shared::BvhNode& node);

/// What is wrong with the tree of a model, or nothing: every surfel in one leaf, every
/// box in the one above, all indices within their arrays, no node seen twice. @param seen
/// [nodes] counts visits, over all models
std::string fault_of_tree(const BvhOnHost& bvh, std::uint32_t root, const Model& model,
                          std::vector<int>& seen);

struct HostRay {
    glm::dvec3 origin, direction;
};

/// Whether a ray meets a box ahead of its origin.
bool meets(const HostRay& ray, const HostBox& box);

/// Walks nodes from `root` into every decoded box the ray meets. @param leaf is given
/// each entry of `order` reached @return nodes visited
std::size_t walk(const std::vector<shared::BvhNode>& nodes, std::uint32_t root, const HostRay& ray,
                 const std::function<void(std::uint32_t)>& leaf);

}  // namespace relidar::test
