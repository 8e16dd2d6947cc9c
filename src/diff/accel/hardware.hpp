// SPDX-License-Identifier: Apache-2.0
// Acceleration structures of the Vulkan driver for ray queries. Each model has a
// bottom-level structure of triangles or boxes that enclose its surfels. The top-level
// structure contains all instances of the models.
#pragma once

#include <memory>

#include <relidar/diff/accel.hpp>
#include <relidar/scene/device_scene.hpp>

#include "diff/accel/surfel_range.hpp"

namespace relidar {

/// A refit keeps the structure of the trees and requires an earlier build.
enum class BuildMode { build, refit };

class RayQueryAccel {
public:
    RayQueryAccel(Device& device, const DeviceScene& scene, ProxyShape proxy);
    ~RayQueryAccel();

    /// Records commands that build or refit the bottom-level acceleration structures of
    /// models, and then build the top-level structure.
    /// @param ranges surfels of the models to update. Other surfels must be unchanged
    void record_build(Stream& stream, const DeviceScene& scene, const AccelOptions& options,
                      const SurfelRanges& ranges, BuildMode mode);
    void rebuild_top_level(Stream& stream, const DeviceScene& scene);
    /// Allocates memory for the last model of the scene, which record_build() must build.
    void append_model(const DeviceScene& scene);
    /// Allocates memory for all instances of the scene.
    void reserve_instances(const DeviceScene& scene);

    /// Returns the addresses that kernels need for ray queries.
    AccelAddresses addresses() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
