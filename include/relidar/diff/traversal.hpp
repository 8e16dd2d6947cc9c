// SPDX-License-Identifier: Apache-2.0
// Batches of rays, options for ray tracing, and the data that the forward pass hands to
// the backward pass.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/diff/rays.h>
#include <relidar/gpu/stream.hpp>

namespace relidar {

/// Rays in world coordinates.
struct WorldRays {
    std::vector<glm::vec3> origin;     ///< Origins, [n] metres.
    std::vector<glm::vec3> direction;  ///< Unit directions, [n].
    /// Firing times, [n] seconds after the reference time of the sweep. Empty: all
    /// instances stay at the poses that were set.
    std::vector<float> time_s = {};
    std::size_t size() const { return direction.size(); }
};

using shared::DeviceRay;

/// Batch of rays on the device. Ray k of the batch is entry first + k * stride.
struct RayBatch {
    const Array<DeviceRay>* rays = nullptr;
    std::uint32_t first = 0;
    std::uint32_t stride = 1;
    std::uint32_t n_rays = 0;
    /// Number of columns if the batch is an image in row order; n_rays is a multiple of
    /// it. Threads that run together then trace tiles of 16 x 2 neighbouring rays, which
    /// visit the same nodes. 0 = trace rays in list order.
    std::uint32_t columns = 0;
    /// Measured targets of the rays, with the same indices as `rays`. Used only with
    /// TraceOptions::likelihood. Null = no targets.
    const Array<shared::DeviceTarget>* targets = nullptr;
};

/// Traversal of the software tree: each ray separately (lane), or all rays of a subgroup
/// together.
enum class Walk { automatic, lane, subgroup };

/// Method for sorting the hits of a ray. `chunks`: hits are sorted in a per-ray buffer
/// while they are found. `lists`: all hits are appended to a list in memory and sorted
/// afterwards.
enum class HitOrder { automatic, chunks, lists };

/// Kernel of the likelihood of a measured range z (docs/method.md M12): k(t) = 1 / (1 +
/// ((t - z) / scale_m)^2).
struct RangeKernel {
    float scale_m = 0.05f;
};

/// Options for ray tracing. They do not change the rendered image.
struct TraceOptions {
    int chunk = 16;  ///< Number of hits sorted at a time, 1..64.
    /// Traversal of the software tree; automatic = the faster method for this type of
    /// device.
    Walk walk = Walk::automatic;
    /// Sorting method of the forward pass; automatic = lists on a GPU, chunks on a CPU.
    HitOrder order = HitOrder::automatic;
    /// Initial capacity of a hit list, 1..512. It is doubled while any ray has more hits.
    /// Rays with too many hits are traced in chunks.
    int list_room = 64;
    /// Blends the normals of surfels, for RenderedSurface. They have no gradient.
    bool normals = false;
    /// Blends the likelihood of each ray that has a measured range.
    std::optional<RangeKernel> likelihood{};
    /// If set, also renders the heaviest surface of each ray (docs/method.md M13).
    /// Consecutive hits at most this far apart belong to one surface, metres.
    std::optional<float> mode_gap_m{};

    /// Returns whether a forward pass writes a RenderedSurface for each ray.
    bool has_surfaces() const { return normals || mode_gap_m; }
};

/// Returns the number of threads that trace a batch. For an image these are full tiles of
/// 16 x 2 rays, so that some threads have no ray. Otherwise it is one thread per ray.
std::size_t trace_threads(const RayBatch& batch);

/// First hits of each ray of a batch, as blended by the forward pass. The backward pass
/// uses them instead of searching the hits again.
struct KeptHits {
    Array<shared::Hit> hits;  ///< Hits, [ceil(n_threads / 2), per_ray, 2].
    /// Number of hits stored per ray. The backward pass searches further hits again.
    std::uint32_t per_ray = 0;

    /// Allocates memory for the hits.
    /// @param n_threads number of threads that trace the largest batch
    KeptHits(Device& device, std::size_t n_threads, std::uint32_t hits_per_ray)
        : hits(device, side_by_side(n_threads) * hits_per_ray, "kept hits"), per_ray(hits_per_ray) {}
    /// Rounds a number of threads up to full groups, whose hits are interleaved in
    /// memory.
    static std::size_t side_by_side(std::size_t n_threads) {
        return (n_threads + RELIDAR_SIDE_BY_SIDE - 1) / RELIDAR_SIDE_BY_SIDE * RELIDAR_SIDE_BY_SIDE;
    }
    /// Returns true if the hits of a batch fit.
    bool hold(const RayBatch& batch) const {
        return side_by_side(trace_threads(batch)) * per_ray <= hits.size();
    }
};

/// Returns the number of hits per ray that should be kept if `n_overfull` rays had more
/// than `per_ray` hits. It is doubled while there are such rays, because on a GPU the
/// second search of a few rays takes as long as all others. The result is at most 256 (4
/// kB per ray), or `per_ray` if that is larger.
std::uint32_t kept_hits_wanted(std::uint32_t per_ray, std::uint64_t n_overfull);

/// Rendered batch with the arrays that losses and the backward pass need.
struct RenderedBatch {
    RayBatch rays;
    /// Rendered values of ForwardPass::run, [n_rays].
    const Array<shared::RenderedRay>* rendered = nullptr;
    /// dL/d(rendered), [n_rays]: written by losses, read by the backward pass.
    Array<shared::RayGradient>* upstream = nullptr;
    const KeptHits* kept = nullptr;  ///< Kept hits of the same ForwardPass::run, or null.
    /// Surfaces of the same ForwardPass::run, [n_rays], or null without
    /// TraceOptions::has_surfaces().
    const Array<shared::RenderedSurface>* surfaces = nullptr;
};

/// Converts rays to the struct that kernels read.
std::vector<DeviceRay> to_device_rays(const WorldRays& rays);

}  // namespace relidar
