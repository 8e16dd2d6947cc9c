// SPDX-License-Identifier: Apache-2.0
// Two-level acceleration structure for ray tracing. Each model has a tree over boxes or
// triangles that enclose its surfels. A top-level tree contains the placed models. If an
// actor moves, only its transform in the top-level tree changes. If the device has ray
// queries, the driver builds the trees. Otherwise relidar builds the trees with its own
// kernels.
#pragma once

#include <cstdint>
#include <memory>

#include <relidar/diff/bvh.h>
#include <relidar/gpu/stream.hpp>

namespace relidar {

class DeviceScene;
namespace shared {
// Empty types that name the content of a device array, used as the second template
// argument of Array. They make it a compile error to pass the wrong array to a kernel.
struct ProxyReach;
struct ModelRadii;
}  // namespace shared

/// Shape that encloses a surfel in the driver's acceleration structure. Both shapes give
/// the same hits. Boxes are faster on lavapipe (a CPU driver). Triangles are faster on
/// ray-tracing hardware: two per surfel, or an icosahedron per 3D Gaussian. relidar's
/// software tree always uses boxes.
enum class ProxyShape { automatic, triangles, boxes };

struct AccelOptions {
    ProxyShape proxy = ProxyShape::automatic;
    /// Each shape around a surfel is scaled by margin_scale and then enlarged by
    /// margin_m. Without this margin, rounding errors of the driver's intersection test
    /// could lose hits.
    float margin_scale = 1.002f;
    float margin_m = 1e-4f;
    /// Conditions for rebuilding a tree. Otherwise the boxes of the tree are only
    /// refitted. A tree is rebuilt after `rebuild_every` refits (0 = never). The software
    /// tree is also rebuilt if its measured traversal cost exceeds `rebuild_growth` times
    /// the cost after the last build.
    int rebuild_every = 1000;
    float rebuild_growth = 1.3f;
};

/// Device addresses of the acceleration structure. A device traces either with ray
/// queries or with the software tree. The addresses of the unused method are null.
struct AccelAddresses {
    shared::TlasHandle tlas;  ///< Top-level acceleration structure, for ray queries.
    /// A ray query finds a 3D Gaussian where the ray enters or leaves an icosahedron
    /// around it. The ray leaves at most this distance (m, maximum over Gaussians) behind
    /// the hit. So a ray query must search this far behind the last needed hit.
    Address<float, shared::ProxyReach> proxy_reach;
    /// Instances that move during the sweep, [n_moving]. Used by ray queries.
    Address<shared::MovingInstance> moving;
    /// Radius of each model, [models]. Used by ray queries.
    Address<float, shared::ModelRadii> model_radii;
    std::uint32_t n_moving = 0;  ///< Number of entries in `moving`.
    shared::BvhPointers bvh;     ///< Addresses of the software tree.
};

/// Returns the shape that encloses surfels on a device. Replaces `automatic` by the shape
/// that is faster on this device.
ProxyShape resolve_proxy(ProxyShape requested_shape, const Device& device);

class AccelerationStructure {
public:
    AccelerationStructure(Device& device, const DeviceScene& scene, const AccelOptions& options);
    ~AccelerationStructure();

    /// Records GPU commands that update all trees to the current surfels. Trees are built
    /// at the first call, if `force_rebuild` is true, or if the options require a
    /// rebuild. Otherwise only their boxes are refitted. The top-level tree over the
    /// instances is always updated.
    void record_refit(Stream& stream, const DeviceScene& scene, bool force_rebuild = false);
    /// Records GPU commands that refit the trees of actors with changing shape, for
    /// example walking persons, and update the top-level tree. Use this function if the
    /// surfels of all other models are unchanged.
    void refit_animated(Stream& stream, const DeviceScene& scene);
    /// Records GPU commands that update only the top-level tree. Use this function if
    /// instances have moved but no surfel has changed.
    void record_top_level(Stream& stream, const DeviceScene& scene);

    /// Builds the tree of the last model of `scene`, and allocates memory for its
    /// instances, after DeviceScene::append_model() or append_instance(). Keeps all other
    /// trees. Waits until the build is finished. Requires an earlier record_refit(); no
    /// submitted GPU work may use the trees.
    /// @param added  scene that contains only this model
    /// @throws OutOfDeviceMemory if memory is exhausted
    void append_model(Stream& stream, const DeviceScene& scene, const DeviceScene& added);
    void append_instances(const DeviceScene& scene);

    /// Starts a measurement of the traversal cost of the software tree and evaluates the
    /// previous measurement. If the cost has grown too much since the last build, the
    /// next record_refit() rebuilds the tree. The function waits until the
    /// GPU has finished the previous measurement. Therefore call it only every few
    /// iterations. The commands of the previous measurement must have been submitted.
    void record_cost(Stream& stream);

    AccelAddresses addresses() const;
    ProxyShape proxy_shape() const;
    std::uint64_t n_updates() const;  ///< Number of builds and refits recorded so far.
    int n_refits() const;             ///< Number of refits recorded since the last build.

    struct Impl;
    const Impl& impl() const { return *impl_; }

private:
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
