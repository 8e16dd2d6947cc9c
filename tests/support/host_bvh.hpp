// SPDX-License-Identifier: Apache-2.0
// Builds a two-level tree in the layout of shared/bvh.h on the host. Splits recursively
// at the median object. Tests can thus check the traversal without the device's tree
// builder. The kernel diff/accel/proxies computes the boxes.
#pragma once

#include <memory>

#include <relidar/diff/accel.hpp>
#include <relidar/scene/device_scene.hpp>

namespace relidar::test {

class HostBvh {
public:
    HostBvh(Device& device, const DeviceScene& scene);
    shared::BvhPointers pointers() const;

private:
    Array<shared::BvhNode> nodes_, top_nodes_;
    Array<std::uint32_t, shared::LeafOrder> order_;
    Array<std::uint32_t, shared::InstanceRoots> roots_;
    Array<std::uint32_t, shared::TopOrder> top_order_;
};

}  // namespace relidar::test
