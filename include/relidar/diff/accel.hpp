// SPDX-License-Identifier: Apache-2.0
// The two-level acceleration structure: one tree a model over boxes or proxies of its
// surfels, a top level over the placed models, so moving an actor rewrites a transform
// and nothing else. The driver's where the device traverses by ray query, else relidar's
// own.
#pragma once

#include <cstdint>
#include <memory>

#include <relidar/diff/bvh.h>
#include <relidar/gpu/stream.hpp>

namespace relidar {

class DeviceScene;
namespace shared {
struct ProxyReach;  // what an array holds, as kernels tell it from others
struct ModelRadii;
}  // namespace shared

/// What stands for a surfel in the driver's tree. Both propose the same hits; `boxes` are
/// faster on lavapipe, `triangles` (two a surfel, an icosahedron a 3D Gaussian) on
/// ray-tracing hardware. The software tree is always over boxes.
enum class Proxy { automatic, triangles, boxes };

struct AccelOptions {
    Proxy proxy = Proxy::automatic;
    /// Proxies are grown by this factor and length, so that rounding in a driver's own
    /// intersection loses no hit.
    float margin_scale = 1.002f;
    float margin_m = 1e-4f;
    /// When a structure is built anew instead of refitted (besides when it is told to):
    /// after so many refits (0 = never), and, software tree alone, at the next update
    /// after check_growth() has seen its cost grown by this factor since the build.
    int rebuild_every = 1000;
    float rebuild_growth = 1.3f;
};

/// The structure that a device's traversal searches; the others are nowhere.
struct AccelAddresses {
    shared::TlasHandle tlas;  ///< ray query
    /// [1] ray query over icosahedra: how far behind a hit one may end
    Address<float, shared::ProxyReach> proxy_reach;
    Address<shared::MovingInstance> moving;          ///< [n_moving] ray query
    Address<float, shared::ModelRadii> model_radii;  ///< [models] ray query
    std::uint32_t n_moving = 0;                      ///< ray query: instances that move during the sweep
    shared::BvhPointers bvh;                         ///< software
};

/// Proxy that suits a device where none is chosen.
Proxy resolve(Proxy proxy, const Device& device);

class Accel {
public:
    Accel(Device& device, const DeviceScene& scene, const AccelOptions& options);
    ~Accel();

    /// Records proxies from the scene's records and a build (first time, when told, or
    /// when due) or refit of all trees, then the top level.
    void update(Stream& stream, const DeviceScene& scene, bool rebuild = false);
    /// Records proxies and a refit of the models that bend alone, then the top level:
    /// actors walk, no other surfel has changed.
    void bend(Stream& stream, const DeviceScene& scene);
    /// Records the top level alone: instances have moved, no surfel has changed.
    void move(Stream& stream, const DeviceScene& scene);

    /// Records a measurement of how much the software tree has grown since its build, and
    /// looks at the one recorded by the call before: the next update() rebuilds a tree
    /// that is outgrown. Waits where that one, which must have been submitted, is not
    /// done: for every so many iterations, not for each.
    void check_growth(Stream& stream);

    AccelAddresses addresses() const;
    Proxy proxy() const;
    std::uint64_t memory_bytes() const;  ///< of structures, proxies and scratch
    std::uint64_t updates() const;       ///< builds and refits recorded so far
    int refits_since_build() const;      ///< refits recorded since the last build

    struct Impl;

private:
    friend const Impl& impl_of(const Accel& accel);  ///< what the library itself works with
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
