// SPDX-License-Identifier: Apache-2.0
// The software acceleration structure (relidar/diff/bvh.h), which the device builds and
// refits.
// One forest holds the trees of all models, so the number of launches does not depend on
// the number of models. The steps are: sort along a space-filling curve, cluster into
// binary trees, collapse into wide nodes of eight children, compute boxes bottom up. Only
// take_cost() and download() make the host wait. Memory per surfel: 24 B for boxes, 92 B
// for scratch, 4 B for the order, 30 B for wide nodes (at most n / 4 nodes, plus one per
// model).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include <relidar/diff/accel.hpp>
#include <relidar/scene/device_scene.hpp>

#include "diff/accel/surfel_range.hpp"

namespace relidar {

/// Copy of a structure on the host, for tests and measurements.
struct BvhOnHost {
    std::vector<shared::BvhNode> nodes;  ///< nodes in use
    std::vector<std::uint32_t> order;    ///< [n] surfels in the order of the leaves
    std::vector<std::uint32_t> roots;    ///< [n_instances] root node of each instance's model
    std::vector<shared::BvhNode> top_nodes;
    std::vector<std::uint32_t> top_order;  ///< [n_instances] instances in the order of the leaves
    /// [n,6] m: boxes of the surfels; low above high for surfels that are never hit
    std::vector<float> boxes;
};

class Bvh {
public:
    /// Allocates memory for the surfels, models and instances of a scene. Does not build
    /// the structure.
    /// @throws DeviceError if compute shaders lack subgroup arithmetic or ballots, or
    /// subgroups have fewer than 4 lanes
    Bvh(Device& device, const DeviceScene& scene);
    ~Bvh();

    /// Records the surfel boxes and a full build of all model trees and the top tree.
    void build(Stream& stream, const DeviceScene& scene, const AccelOptions& options);
    /// Records new surfel boxes, new node boxes with the same topology, and the top tree.
    /// build() must have been called before.
    /// @param ranges  models to update; the surfels of other models must not have changed
    void refit(Stream& stream, const DeviceScene& scene, const AccelOptions& options,
               const std::vector<SurfelRange>& ranges);
    /// Records only the top tree. Call it after instances have moved.
    void move(Stream& stream, const DeviceScene& scene);

    shared::BvhPointers pointers() const;
    std::uint64_t memory_bytes() const;
    /// Computes the surface-area cost of all current trees in m^2: half areas of nodes,
    /// and of leaf slots times the cost of testing their surfels. Compare the cost with
    /// its value after the last build. record_cost() records the kernel. take_cost()
    /// waits for the result and returns it, or nothing if no cost was recorded since the
    /// last call.
    void record_cost(Stream& stream);
    std::optional<double> take_cost(Stream& stream);
    /// Copies the structure to the host and blocks. All recorded commands must have been
    /// submitted.
    BvhOnHost download() const;

    /// Returns the capacity in wide nodes. n surfels make at most n / 4 nodes besides the
    /// roots (diff/accel/bvh_wide_mark).
    static std::uint32_t node_bound(std::uint32_t n_surfels, std::uint32_t n_models) {
        return n_surfels / 4 + n_models;
    }

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
