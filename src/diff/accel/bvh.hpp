// SPDX-License-Identifier: Apache-2.0
// The software acceleration structure (shared/bvh.h), built and refitted on the device.
// One forest holds the trees of all models, so the number of launches does not depend on
// how many there are: sort along a space-filling curve, binary trees by agglomeration,
// collapse to the cheapest eight children, boxes bottom up. The host waits for nothing
// and reads nothing but in take_cost() and download(). Memory: 24 B a surfel for boxes,
// 92 for scratch, 4 for the order, 30 for wide nodes (at most n / 4 and one a model).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include <relidar/diff/accel.hpp>
#include <relidar/scene/device_scene.hpp>

#include "diff/accel/surfel_range.hpp"

namespace relidar {

/// All of a structure on the host, for tests and measurements.
struct BvhOnHost {
    std::vector<shared::BvhNode> nodes;  ///< as far as they are in use
    std::vector<std::uint32_t> order;    ///< [n]
    std::vector<std::uint32_t> roots;    ///< [n_instances]
    std::vector<shared::BvhNode> top_nodes;
    std::vector<std::uint32_t> top_order;  ///< [n_instances]
    std::vector<float> boxes;              ///< [n,6] m: of the surfels; low above high where never hit
};

class Bvh {
public:
    /// Room for the surfels, models and instances of a scene. Nothing is built yet.
    /// @throws DeviceError where the device has no subgroup arithmetic and ballots in
    /// compute, or subgroups of fewer than 4
    Bvh(Device& device, const DeviceScene& scene);
    ~Bvh();

    /// Records boxes from the scene's records and a full build of all model trees and the
    /// top tree.
    void build(Stream& stream, const DeviceScene& scene, const AccelOptions& options);
    /// Records boxes and new node bounds bottom up, same topology, then the top tree.
    /// Needs a build before.
    /// @param ranges  whose trees: the surfels of others have not changed
    void refit(Stream& stream, const DeviceScene& scene, const AccelOptions& options,
               const std::vector<SurfelRange>& ranges);
    /// Records the top tree alone: instances have moved.
    void move(Stream& stream, const DeviceScene& scene);

    shared::BvhPointers pointers() const;
    std::uint64_t memory_bytes() const;
    /// Surface-area cost of all trees as they are now, m^2: half areas of nodes, and of
    /// leaf slots times the tests of their surfels. Compare with the value after the last
    /// build. Recorded now, read when submitted: waits where it is not done; nothing
    /// where none was recorded since the last.
    void record_cost(Stream& stream);
    std::optional<double> take_cost(Stream& stream);
    /// Blocking; what was recorded must have been submitted.
    BvhOnHost download() const;

    /// Wide nodes there is room for: n surfels make at most n / 4 nodes besides the roots
    /// (diff/accel/bvh_wide_mark).
    static std::uint32_t node_bound(std::uint32_t n_surfels, std::uint32_t n_models) {
        return n_surfels / 4 + n_models;
    }

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
