// SPDX-License-Identifier: Apache-2.0
// Two-level acceleration structure for ray tracing. Each model has a tree over boxes or
// triangles that enclose its surfels. A top-level tree contains the placed models, so a
// moving actor changes only a transform. The driver builds the trees if the device has
// ray queries. Otherwise relidar builds them in software.
#pragma once

#include <cstdint>
#include <memory>

#include <relidar/diff/bvh.h>
#include <relidar/gpu/stream.hpp>

namespace relidar {

class DeviceScene;
namespace shared {
// Tag types for the content of device arrays. They prevent passing the wrong array to a
// kernel when the element types are equal.
struct ProxyReach;
struct ModelRadii;
}  // namespace shared

/// Geometry that encloses a surfel in the driver's acceleration structure. Both kinds
/// give the same hits. `boxes` are faster on lavapipe. `triangles` are faster on
/// ray-tracing hardware: two per surfel, or an icosahedron per 3D Gaussian. The software
/// tree always uses boxes.
enum class Proxy { automatic, triangles, boxes };

struct AccelOptions {
    Proxy proxy = Proxy::automatic;
    /// Factor and length by which the enclosing geometry is enlarged. The margin prevents
    /// lost hits when the driver's intersection test has rounding errors.
    float margin_scale = 1.002f;
    float margin_m = 1e-4f;
    /// Conditions under which trees are rebuilt instead of refitted. A tree is rebuilt
    /// after `rebuild_every` refits (0 = never). The software tree is also rebuilt when
    /// its measured traversal cost exceeds `rebuild_growth` times the cost after its last
    /// build.
    int rebuild_every = 1000;
    float rebuild_growth = 1.3f;
};

/// Device addresses of the acceleration structure. Only the addresses for the device's
/// traversal method are set. The others are null.
struct AccelAddresses {
    shared::TlasHandle tlas;  ///< Top-level acceleration structure, for ray queries.
    /// Largest distance between a hit and the point where the ray leaves its icosahedron,
    /// [1]. Used by ray queries over icosahedra.
    Address<float, shared::ProxyReach> proxy_reach;
    /// Instances that move during the sweep, [n_moving]. Used by ray queries.
    Address<shared::MovingInstance> moving;
    /// Radius of each model, [models]. Used by ray queries.
    Address<float, shared::ModelRadii> model_radii;
    std::uint32_t n_moving = 0;  ///< Number of entries in `moving`.
    shared::BvhPointers bvh;     ///< Addresses of the software tree.
};

/// Returns the geometry kind to use on a device. Replaces `automatic` by the faster kind.
Proxy resolve(Proxy proxy, const Device& device);

class Accel {
public:
    Accel(Device& device, const DeviceScene& scene, const AccelOptions& options);
    ~Accel();

    /// Records GPU commands that recompute the enclosing geometry, then build or refit
    /// all trees, and finally update the top level. The trees are built at the first
    /// call, if `rebuild` is true, or if the options require a rebuild. Otherwise they
    /// are refitted.
    void update(Stream& stream, const DeviceScene& scene, bool rebuild = false);
    /// Records GPU commands that refit only the trees of walking actors and update the
    /// top level. Use this function if no other surfel has changed.
    void bend(Stream& stream, const DeviceScene& scene);
    /// Records GPU commands that update only the top level. Use this function if
    /// instances have moved but no surfel has changed.
    void move(Stream& stream, const DeviceScene& scene);

    /// Measures the traversal cost of the software tree and evaluates the previous
    /// measurement. If the cost has grown too much since the build, the next update()
    /// rebuilds the tree. The function waits until the GPU has finished the previous
    /// measurement, which must have been submitted. Therefore call it only every few
    /// iterations.
    void check_growth(Stream& stream);

    AccelAddresses addresses() const;
    Proxy proxy() const;
    /// Device memory of trees, enclosing geometry and scratch buffers, bytes.
    std::uint64_t memory_bytes() const;
    std::uint64_t updates() const;   ///< Number of builds and refits recorded so far.
    int refits_since_build() const;  ///< Number of refits recorded since the last build.

    struct Impl;

private:
    /// Returns the internal implementation. Only the library uses this function.
    friend const Impl& impl_of(const Accel& accel);
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
