// SPDX-License-Identifier: Apache-2.0
#include "host_bvh.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "base/longest_axis.hpp"
#include "diff/shared/accel.h"
#include "gpu/stream.hpp"

namespace relidar::test {
namespace {

struct Box {
    glm::vec3 low{std::numeric_limits<float>::infinity()};
    glm::vec3 high{-std::numeric_limits<float>::infinity()};
    void grow(const Box& b) {
        low = glm::min(low, b.low);
        high = glm::max(high, b.high);
    }
    bool finite() const { return std::isfinite(glm::dot(low, low)) && std::isfinite(glm::dot(high, high)); }
};

using Indices = std::vector<std::uint32_t>;

/// Builds a single tree. Appends its nodes, and its primitives in the order of the
/// leaves. The children of a node are contiguous.
class Builder {
public:
    Builder(const std::vector<Box>& boxes, std::vector<shared::BvhNode>& nodes, Indices& order)
        : boxes_(boxes), nodes_(nodes), order_(order) {}

    /// Builds the subtree of some primitives.
    /// @return index of the root of the subtree
    std::uint32_t build(Indices primitives) {
        const auto root = static_cast<std::uint32_t>(nodes_.size());
        nodes_.emplace_back();
        fill(root, std::move(primitives));
        return root;
    }

private:
    const std::vector<Box>& boxes_;
    std::vector<shared::BvhNode>& nodes_;
    Indices& order_;

    Box bounds(const Indices& primitives) const {
        Box box;
        for (const std::uint32_t p : primitives) box.grow(boxes_[p]);
        return box;
    }

    Indices split_half(Indices& primitives) const {
        Box centres;
        for (const std::uint32_t p : primitives)
            centres.grow({boxes_[p].low + boxes_[p].high, boxes_[p].low + boxes_[p].high});
        const int axis = find_longest_axis(centres.high - centres.low);
        const auto middle = primitives.begin() + std::ptrdiff_t(primitives.size() / 2);
        std::nth_element(primitives.begin(), middle, primitives.end(),
                         [&](std::uint32_t first, std::uint32_t second) {
                             return boxes_[first].low[axis] + boxes_[first].high[axis] <
                                    boxes_[second].low[axis] + boxes_[second].high[axis];
                         });
        Indices half(middle, primitives.end());
        primitives.erase(middle, primitives.end());
        return half;
    }

    std::vector<Indices> split(Indices primitives) const {
        std::vector<Indices> parts{std::move(primitives)};
        while (parts.size() < RELIDAR_BVH_WIDTH) {
            const auto largest = std::max_element(
                parts.begin(), parts.end(),
                [](const Indices& first, const Indices& second) { return first.size() < second.size(); });
            if (largest->size() <= RELIDAR_BVH_LEAF_SIZE) break;
            Indices half = split_half(*largest);
            parts.push_back(std::move(half));
        }
        return parts;
    }

    void fill(std::uint32_t at, Indices primitives) {
        shared::BvhNode node{};
        const Box bounding_box = bounds(primitives);
        const std::vector<Indices> parts =
            primitives.empty() ? std::vector<Indices>{} : split(std::move(primitives));
        node.origin = parts.empty() ? glm::vec3(0.0f) : bounding_box.low;
        node.first_leaf = static_cast<std::uint32_t>(order_.size());
        const auto n_inner = static_cast<std::uint32_t>(std::count_if(
            parts.begin(), parts.end(), [](const Indices& p) { return p.size() > RELIDAR_BVH_LEAF_SIZE; }));
        node.first_child = static_cast<std::uint32_t>(nodes_.size());
        nodes_.resize(nodes_.size() + n_inner);
        for (int axis = 0; axis < 3; ++axis) set_axis(node, axis, parts, bounding_box);
        std::uint32_t child = node.first_child;
        for (std::size_t slot = 0; slot < parts.size(); ++slot) {
            if (parts[slot].size() > RELIDAR_BVH_LEAF_SIZE) {
                node.exponents |= 1u << (24 + slot);
                continue;
            }
            const auto offset = static_cast<std::uint32_t>(order_.size()) - node.first_leaf;
            node.leaves[slot / 4] |= (offset | static_cast<std::uint32_t>(parts[slot].size()) << 5)
                                     << (8 * (slot % 4));
            order_.insert(order_.end(), parts[slot].begin(), parts[slot].end());
        }
        nodes_[at] = node;
        for (const Indices& part : parts)
            if (part.size() > RELIDAR_BVH_LEAF_SIZE) fill(child++, part);
    }

    /// Quantises the boxes of the children along an axis, rounded outward in exact
    /// arithmetic.
    void set_axis(shared::BvhNode& node, int axis, const std::vector<Indices>& parts,
                  const Box& whole) const {
        shared::uint* const lows[] = {node.low_x, node.low_y, node.low_z};
        shared::uint* const highs[] = {node.high_x, node.high_y, node.high_z};
        shared::uint *const low = lows[axis], *const high = highs[axis];
        const double origin = double(node.origin[axis]),
                     extent = parts.empty() ? 0.0 : double(whole.high[axis]) - origin;
        const int exponent = extent > 0.0 ? std::max(1, 127 + int(std::ceil(std::log2(extent / 255.0)))) : 0;
        const double step = exponent ? std::exp2(exponent - 127) : 1.0;
        node.exponents |= static_cast<std::uint32_t>(exponent) << (8 * axis);
        for (std::size_t slot = 0; slot < RELIDAR_BVH_WIDTH; ++slot) {
            std::uint32_t q_low = 255, q_high = 0;
            if (slot < parts.size()) {
                const Box box = bounds(parts[slot]);
                q_low = static_cast<std::uint32_t>(
                    std::clamp(std::floor((double(box.low[axis]) - origin) / step), 0.0, 255.0));
                q_high = static_cast<std::uint32_t>(
                    std::clamp(std::ceil((double(box.high[axis]) - origin) / step), 0.0, 255.0));
            }
            low[slot / 4] |= q_low << (8 * (slot % 4));
            high[slot / 4] |= q_high << (8 * (slot % 4));
        }
    }
};

std::vector<Box> surfel_boxes(Device& device, const DeviceScene& scene) {
    Stream stream(device);
    const std::vector<SpecialisationConstant> constants{
        {SpecialisationConstantId::BOXES, 1u},
        {SpecialisationConstantId::PRIMITIVE, static_cast<std::uint32_t>(scene.primitive())}};
    const Kernel<shared::ProxyParams> proxies(device, "diff/accel/proxies", constants);
    const Array<float, shared::SurfelBoxes> boxes(device, 6 * std::size_t(scene.size()), "boxes");
    const AccelOptions margin;
    run(stream, proxies, scene.size(),
        {.records = scene.get_surfel_records().address(),
         .vertices = {},
         .boxes = boxes.address(),
         .reach = {},
         .alpha_min = scene.alpha_min(),
         .margin_m = margin.margin_m,
         .margin_scale = margin.margin_scale,
         .n_surfels = scene.size()});
    stream.submit_and_wait();
    const std::vector<float> values = boxes.download();
    std::vector<Box> result;
    for (std::size_t i = 0; i < scene.size(); ++i)
        result.push_back({{values[6 * i], values[6 * i + 1], values[6 * i + 2]},
                          {values[6 * i + 3], values[6 * i + 4], values[6 * i + 5]}});
    return result;
}

Box to_world(const Box& box, const Pose& world_from_model) {
    Box result;
    const glm::dmat4 m = to_matrix(world_from_model);
    for (int corner = 0; corner < 8; ++corner) {
        const glm::dvec3 p((corner & 1) ? box.high.x : box.low.x, (corner & 2) ? box.high.y : box.low.y,
                           (corner & 4) ? box.high.z : box.low.z);
        const glm::dvec3 q(m * glm::dvec4(p, 1.0));
        const double pad = 1e-6 * glm::length(q) + 1e-5;
        result.grow({glm::vec3(q - pad), glm::vec3(q + pad)});
    }
    return result;
}

}  // namespace

HostBvh::HostBvh(Device& device, const DeviceScene& scene) {
    const std::vector<Box> boxes = surfel_boxes(device, scene);
    const Scene& layout = scene.get_scene_layout();
    std::vector<shared::BvhNode> nodes, top_nodes;
    Indices order, top_order, root_of_model, roots;
    std::vector<Box> model_box;
    for (const SurfelModel& model : layout.models) {
        const std::vector<Box> model_surfel_boxes(boxes.begin() + model.first,
                                                  boxes.begin() + model.first + model.count);
        Indices usable;
        Box bounding_box;
        for (std::uint32_t i = 0; i < model.count; ++i)
            if (model_surfel_boxes[i].finite()) {
                usable.push_back(i);
                bounding_box.grow(model_surfel_boxes[i]);
            }
        model_box.push_back(bounding_box);
        root_of_model.push_back(usable.empty() ? RELIDAR_BVH_NO_NODE
                                               : Builder(model_surfel_boxes, nodes, order).build(usable));
    }
    Indices placed;
    std::vector<Box> instance_box;
    for (std::uint32_t i = 0; i < layout.instances.size(); ++i) {
        const std::uint32_t model = layout.instances[i].model;
        const bool there =
            scene.get_instance_poses()[i].present && root_of_model[model] != RELIDAR_BVH_NO_NODE;
        roots.push_back(there ? root_of_model[model] : RELIDAR_BVH_NO_NODE);
        instance_box.push_back(
            there ? to_world(model_box[model], scene.get_instance_poses()[i].world_from_model) : Box());
        if (there) placed.push_back(i);
    }
    Builder(instance_box, top_nodes, top_order).build(placed);
    nodes_ = Array<shared::BvhNode>(device, std::span<const shared::BvhNode>(nodes), "nodes");
    top_nodes_ = Array<shared::BvhNode>(device, std::span<const shared::BvhNode>(top_nodes), "top nodes");
    order_ = {device, std::span<const std::uint32_t>(order), "order"};
    roots_ = {device, std::span<const std::uint32_t>(roots), "roots"};
    top_order_ = {device, std::span<const std::uint32_t>(top_order), "top order"};
}

shared::BvhPointers HostBvh::pointers() const {
    return {.nodes = nodes_.address(),
            .order = order_.address(),
            .roots = roots_.address(),
            .top_nodes = top_nodes_.address(),
            .top_order = top_order_.address()};
}

}  // namespace relidar::test
