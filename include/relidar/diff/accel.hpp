// SPDX-License-Identifier: Apache-2.0
// Two-level acceleration structure. Each model has a tree over boxes or proxies of its
// surfels, and a top level contains the placed models. Moving an actor therefore changes
// only a transform. With ray queries the structure belongs to the driver; otherwise it is
// relidar's own tree.
#pragma once

#include <cstdint>
#include <memory>

#include <relidar/diff/bvh.h>
#include <relidar/gpu/stream.hpp>

namespace relidar {

class DeviceScene;
namespace shared {
// Content types of device arrays. Kernels use them to distinguish arrays of the same
// element type.
struct ProxyReach;
struct ModelRadii;
}  // namespace shared

/// Geometry that represents a surfel in the driver's tree. Both kinds give the same hits.
/// `boxes` are faster on lavapipe. `triangles` (two per surfel, an icosahedron per 3D
/// Gaussian) are faster on ray-tracing hardware. The software tree always uses boxes.
enum class Proxy { automatic, triangles, boxes };

struct AccelOptions {
    Proxy proxy = Proxy::automatic;
    /// Factor and length by which proxies are enlarged, so that rounding errors in a
    /// driver's intersection test lose no hit.
    float margin_scale = 1.002f;
    float margin_m = 1e-4f;
    /// Conditions for a rebuild instead of a refit, in addition to explicit requests. The
    /// structure is rebuilt after `rebuild_every` refits (0 = never). The software tree
    /// is also rebuilt at the next update after check_growth() has measured that its cost
    /// exceeds `rebuild_growth` times the cost after the build.
    int rebuild_every = 1000;
    float rebuild_growth = 1.3f;
};

/// Addresses of the structure that a device's traversal method uses. The other addresses
/// are null.
struct AccelAddresses {
    shared::TlasHandle tlas;  ///< Top-level acceleration structure, for ray queries.
    /// Largest distance between a hit and the end of its icosahedron, [1]. For ray
    /// queries over icosahedra.
    Address<float, shared::ProxyReach> proxy_reach;
    /// Instances that move during the sweep, [n_moving], for ray queries.
    Address<shared::MovingInstance> moving;
    Address<float, shared::ModelRadii> model_radii;  ///< Radii of the models, [models], for ray queries.
    std::uint32_t n_moving = 0;  ///< Number of instances that move during the sweep, for ray queries.
    shared::BvhPointers bvh;     ///< Software tree.
};

/// Returns the proxy to use on a device; replaces `automatic` by the faster kind.
Proxy resolve(Proxy proxy, const Device& device);

class Accel {
public:
    Accel(Device& device, const DeviceScene& scene, const AccelOptions& options);
    ~Accel();

    /// Records the computation of proxies from the scene's records, then a build or refit
    /// of all trees, then the top level. Builds the trees at the first call, if `rebuild`
    /// is true, or if the options require a rebuild.
    void update(Stream& stream, const DeviceScene& scene, bool rebuild = false);
    /// Records proxies and a refit of walking actors only, then the top level. Use it if
    /// no other surfel has changed.
    void bend(Stream& stream, const DeviceScene& scene);
    /// Records an update of the top level only. Use it if instances have moved but no
    /// surfel has changed.
    void move(Stream& stream, const DeviceScene& scene);

    /// Records a measurement of the software tree's cost, and evaluates the measurement
    /// of the previous call. If the cost has grown too much since the build, the next
    /// update() rebuilds the tree. Blocks until the previous measurement is done, which
    /// must have been submitted. Therefore call it every few iterations, not in each one.
    void check_growth(Stream& stream);

    AccelAddresses addresses() const;
    Proxy proxy() const;
    /// Device memory of structures, proxies and scratch buffers, bytes.
    std::uint64_t memory_bytes() const;
    std::uint64_t updates() const;   ///< Number of builds and refits recorded so far.
    int refits_since_build() const;  ///< Number of refits recorded since the last build.

    struct Impl;

private:
    /// Returns the internal implementation; used only inside the library.
    friend const Impl& impl_of(const Accel& accel);
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
