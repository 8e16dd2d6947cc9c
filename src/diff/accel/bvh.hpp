// SPDX-License-Identifier: Apache-2.0
// Software acceleration structure that the device builds and refits. The trees of all
// models share the same arrays, so that the number of launches does not depend on the
// number of models. Memory per surfel: 24 B boxes, 92 B scratch, 4 B order, 30 B nodes.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include <relidar/diff/accel.hpp>
#include <relidar/scene/device_scene.hpp>

#include "diff/accel/surfel_range.hpp"

namespace relidar {

/// Copy of the BVH (bounding volume hierarchy) in host memory, for tests and
/// measurements.
struct HostBvhCopy {
    std::vector<shared::BvhNode> nodes;  ///< nodes in use
    std::vector<std::uint32_t> order;    ///< [n] surfels in the order of the leaves
    std::vector<std::uint32_t> roots;    ///< [n_instances] root node of each instance's model
    std::vector<shared::BvhNode> top_nodes;
    std::vector<std::uint32_t> top_order;  ///< [n_instances] instances in the order of the leaves
    /// [n,6] boxes of the surfels in m. If no ray can hit a surfel, the lower corner of
    /// its box is above the upper corner.
    std::vector<float> boxes;
};

class Bvh {
public:
    /// Allocates memory for the surfels, models and instances of a scene. build_trees()
    /// must be called before the first use.
    /// @throws DeviceError if compute shaders lack subgroup arithmetic or ballots, or
    /// subgroups have fewer than 4 lanes
    Bvh(Device& device, const DeviceScene& scene);
    ~Bvh();

    void build_trees(Stream& stream, const DeviceScene& scene, const AccelOptions& options);
    /// Submits kernels that update the boxes in the trees of models (not their structure)
    /// and rebuild the top-level tree. Requires an earlier build_trees().
    /// @param ranges models to update. The surfels of other models must not have changed
    void refit_trees(Stream& stream, const DeviceScene& scene, const AccelOptions& options,
                     const SurfelRanges& ranges);
    /// Submits the kernel that builds the tree over the instances at their current poses.
    void rebuild_top_level(Stream& stream, const DeviceScene& scene);
    /// Copies the tree of `added`, the last model of `scene`, behind the other trees.
    /// Waits for the device.
    void append_tree(const DeviceScene& scene, const Bvh& added);
    /// Allocates memory for all instances of the scene.
    void append_instances(const DeviceScene& scene);

    shared::BvhPointers bvh_addresses() const;
    /// Submits a kernel that computes the traversal cost of all trees (surface area
    /// heuristic, m^2). A rebuild is useful if the cost has grown much since a build.
    void measure_cost(Stream& stream);
    /// Waits for the cost. Returns nothing if no measurement was recorded.
    std::optional<double> read_cost(Stream& stream);
    /// For tests. Waits for the device. All recorded commands must be submitted.
    HostBvhCopy download_bvh() const;

    /// Returns the maximum number of nodes in the trees of all models: n / 4 nodes for n
    /// surfels, plus one root per model.
    static std::uint32_t max_node_count(std::uint32_t n_surfels, std::uint32_t n_models) {
        return n_surfels / 4 + n_models;
    }

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
