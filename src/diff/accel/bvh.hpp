// SPDX-License-Identifier: Apache-2.0
// The software acceleration structure (relidar/diff/bvh.h), which the device builds and
// refits.
// One forest holds the trees of all models, so the number of launches does not depend on
// the number of models. The steps are: sort along a space-filling curve, cluster into
// binary trees, collapse into wide nodes of eight children, compute boxes bottom up. Only
// read_cost() and download() make the host wait. Memory per surfel: 24 B for boxes, 92 B
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

/// Copy of the BVH on the host, for tests and measurements.
struct BvhOnHost {
    std::vector<shared::BvhNode> nodes;  ///< nodes in use
    std::vector<std::uint32_t> order;    ///< [n] surfels in the order of the leaves
    std::vector<std::uint32_t> roots;    ///< [n_instances] root node of each instance's model
    std::vector<shared::BvhNode> top_nodes;
    std::vector<std::uint32_t> top_order;  ///< [n_instances] instances in the order of the leaves
    /// [n,6] in m: boxes of the surfels. The lower corner is above the upper corner for
    /// surfels that are never hit.
    std::vector<float> boxes;
};

class Bvh {
public:
    /// Allocates memory for the surfels, models and instances of a scene. Does not build
    /// the BVH.
    /// @throws DeviceError if compute shaders lack subgroup arithmetic or ballots, or
    /// subgroups have fewer than 4 lanes
    Bvh(Device& device, const DeviceScene& scene);
    ~Bvh();

    /// Submits kernels to the stream that compute the surfel boxes and build the trees of
    /// all models and the top tree.
    void build(Stream& stream, const DeviceScene& scene, const AccelOptions& options);
    /// Submits kernels to the stream that update all boxes without changing the trees,
    /// and rebuild the top tree. build() must have been called before.
    /// @param ranges  models to update. The surfels of other models must not have
    /// changed.
    void refit(Stream& stream, const DeviceScene& scene, const AccelOptions& options,
               const std::vector<SurfelRange>& ranges);
    /// Submits kernels to the stream that rebuild only the tree over the instances. Call
    /// it after instances have moved.
    void move(Stream& stream, const DeviceScene& scene);

    shared::BvhPointers pointers() const;
    std::uint64_t memory_bytes() const;
    /// Computes the surface-area cost of all trees in m^2. Compare the cost with its
    /// value after the last build to decide about a rebuild. record_cost() submits the
    /// kernel. read_cost() waits for the result and returns it, or nothing if
    /// record_cost() was not called since the last read_cost().
    void record_cost(Stream& stream);
    std::optional<double> read_cost(Stream& stream);
    /// Copies the BVH to the host and blocks. All recorded commands must have been
    /// submitted before.
    BvhOnHost download() const;

    /// Returns the largest possible number of wide nodes. n surfels create at most n / 4
    /// nodes, plus one root per model.
    static std::uint32_t node_bound(std::uint32_t n_surfels, std::uint32_t n_models) {
        return n_surfels / 4 + n_models;
    }

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
