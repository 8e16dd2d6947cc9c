// SPDX-License-Identifier: Apache-2.0
// A two-level tree in the layout of shared/bvh.h, built on the host by recursive object
// median: tests of the traversal alone, which must not depend on the device's builder.
// Boxes are the device's own (diff/accel/proxies).
#pragma once

#include <memory>

#include <relidar/diff/accel.hpp>
#include <relidar/scene/device_scene.hpp>

namespace relidar::test {

class HostBvh {
public:
    /// The scene must be activated. Blocks.
    HostBvh(Device& device, const DeviceScene& scene);
    shared::BvhPointers pointers() const;

private:
    Array<shared::BvhNode> nodes_, top_nodes_;
    Array<std::uint32_t, shared::LeafOrder> order_;
    Array<std::uint32_t, shared::InstanceRoots> roots_;
    Array<std::uint32_t, shared::TopOrder> top_order_;
};

}  // namespace relidar::test
