// SPDX-License-Identifier: Apache-2.0
// Acceleration structures of the driver over the proxies (M3), for ray query. One bottom
// level per model, one instance per placed model. Needs a device with ray query.
#pragma once

#include <cstdint>
#include <memory>

#include <relidar/diff/accel.hpp>
#include <relidar/scene/device_scene.hpp>

#include "diff/accel/surfel_range.hpp"

namespace relidar {

class HardwareAccel {
public:
    /// Allocates memory for the scene. Does not build the structures.
    /// @param proxy  triangles or boxes
    HardwareAccel(Device& device, const DeviceScene& scene, Proxy proxy);
    ~HardwareAccel();

    /// Records the proxies, a build or refit of bottom levels, and the top level. A refit
    /// needs an earlier build.
    /// @param ranges  models to update; the surfels of other models must not have changed
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
