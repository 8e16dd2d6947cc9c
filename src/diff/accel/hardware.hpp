// SPDX-License-Identifier: Apache-2.0
// The driver's acceleration structures over proxies (M3): what ray query searches. One
// bottom level a model, one instance a placed model. Needs a device opened for ray query.
#pragma once

#include <cstdint>
#include <memory>

#include <relidar/diff/accel.hpp>
#include <relidar/scene/device_scene.hpp>

#include "diff/accel/surfel_range.hpp"

namespace relidar {

class HardwareAccel {
public:
    /// Room for the scene. Nothing is built yet. @param proxy triangles or boxes
    HardwareAccel(Device& device, const DeviceScene& scene, Proxy proxy);
    ~HardwareAccel();

    /// Records proxies, a build or refit of bottom levels, and the top level. A refit
    /// needs a build before.
    /// @param ranges  the models of which: the surfels of others have not changed
    void record(Stream& stream, const DeviceScene& scene, const AccelOptions& options,
                const std::vector<SurfelRange>& ranges, bool refit);
    /// Records the top level alone.
    void move(Stream& stream, const DeviceScene& scene);

    /// Fills in what ray query reads.
    void fill(AccelAddresses& addresses) const;
    std::uint64_t memory_bytes() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
