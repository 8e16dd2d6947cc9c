// SPDX-License-Identifier: Apache-2.0
// Proxy geometry and the two-level acceleration structure over it: one bottom level a model, one top-level instance a placed
// model, so moving an actor rewrites a transform and nothing else.
#pragma once

#include <cstdint>
#include <memory>

#include <relidar/gpu.hpp>
#include <relidar/scene.hpp>

namespace relidar {

/// What stands for a surfel in the tree. Both propose the same hits; `boxes` are faster on lavapipe, `triangles` on ray-tracing hardware.
enum class Proxy { automatic, triangles, boxes };

struct AccelOptions {
    Proxy proxy = Proxy::automatic;
    /// Proxies are grown by this factor and length, so that rounding in a driver's own intersection loses no hit.
    float margin_scale = 1.002f;
    float margin_m = 1e-4f;
};

/// Proxy that suits a device where none is chosen.
Proxy resolve(Proxy proxy, const Device& device);

class Accel {
public:
    Accel(Device& device, const DeviceScene& scene, const AccelOptions& options);
    ~Accel();

    /// Records proxies from the scene's records and a build (first time, or rebuild) or refit of all bottom levels, then the top level.
    void update(Stream& stream, const DeviceScene& scene, bool rebuild = false);
    /// Records the top level alone: instances have moved, no surfel has changed.
    void move(Stream& stream, const DeviceScene& scene);

    std::uint64_t tlas_address() const;
    Proxy proxy() const;
    std::uint64_t memory_bytes() const;   ///< of structures, proxies and scratch
    std::uint64_t builds() const;         ///< bottom-level builds and refits recorded so far

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
