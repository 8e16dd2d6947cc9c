// SPDX-License-Identifier: Apache-2.0
// Acceleration structures of the Vulkan driver for ray queries. They contain proxies that
// enclose the surfels. Each model has one bottom level, and each instance of a model is
// one instance in the top level. Needs a device with ray query.
#pragma once

#include <cstdint>
#include <memory>

#include <relidar/diff/accel.hpp>
#include <relidar/scene/device_scene.hpp>

#include "diff/accel/surfel_range.hpp"

namespace relidar {

class HardwareAccel {
public:
    /// Allocates memory for the acceleration structures of a scene. Does not build them.
    /// @param proxy  geometry that encloses the surfels: triangles or boxes
    HardwareAccel(Device& device, const DeviceScene& scene, Proxy proxy);
    ~HardwareAccel();

    /// Adds commands to the stream that compute the proxies, build or refit the bottom
    /// levels, and build the top level. A refit needs an earlier build.
    /// @param ranges  models to update. The surfels of other models must not have
    /// changed.
    void record(Stream& stream, const DeviceScene& scene, const AccelOptions& options,
                const std::vector<SurfelRange>& ranges, bool refit);
    /// Records only the top level.
    void move(Stream& stream, const DeviceScene& scene);

    /// Sets the addresses that ray query reads.
    void fill(AccelAddresses& addresses) const;
    std::uint64_t memory_bytes() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
