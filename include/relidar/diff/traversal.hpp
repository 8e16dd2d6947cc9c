// SPDX-License-Identifier: Apache-2.0
// Batches of rays, how they are traced, and what forward and backward hand to each other.
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
    std::vector<glm::vec3> origin;     ///< [n] metres
    std::vector<glm::vec3> direction;  ///< [n] unit
    /// [n] when each is fired, from the sweep's reference time; empty: instances stand at
    /// their poses
    std::vector<float> time_s = {};
    std::size_t size() const { return direction.size(); }
};

using shared::DeviceRay;

/// Ray k of a batch is entry first + k * stride.
struct RayBatch {
    const Array<DeviceRay>* rays = nullptr;
    std::uint32_t first = 0;
    std::uint32_t stride = 1;
    std::uint32_t n_rays = 0;
    /// Where the batch is an image, row by row: its columns, of which n_rays is a
    /// multiple. Threads that run together then trace tiles of 16 x 2 neighbours, which
    /// open the same nodes. 0 = rays as they come.
    std::uint32_t columns = 0;
    /// What the rays measured, entry by entry as `rays`; looked at with
    /// TraceOptions::likelihood alone. Null = nothing.
    const Array<shared::DeviceTarget>* targets = nullptr;
};

/// Whether each ray walks the software tree on its own or the rays of a subgroup walk it
/// together.
enum class Walk { automatic, lane, subgroup };

/// How a ray puts its hits in order: those of a chunk as they are found, in a buffer of
/// its own, or all of them afterwards, appended to a list in memory.
enum class HitOrder { automatic, chunks, lists };

/// Kernel of the likelihood of a measured range z (docs/method.md M12): k(t) = 1 / (1 +
/// ((t - z) / scale_m)^2).
struct RangeKernel {
    float scale_m = 0.05f;
};

/// How rays are traced; none of it changes the image.
struct TraceOptions {
    int chunk = 16;  ///< hits sorted at a time, 1..64
    /// software traversal alone; automatic = what measures faster on the kind of device
    Walk walk = Walk::automatic;
    /// of the forward pass; automatic = lists on a GPU, chunks on a CPU
    HitOrder order = HitOrder::automatic;
    /// Hits that a list has room for at first, 1..512; twice as many while any ray has
    /// more. Rays that have more are traced in chunks.
    int list_room = 64;
    /// Blends the normals of surfels, for RenderedSurface. They have no gradient.
    bool normals = false;
    /// Blends the likelihood of each ray that has a measured range.
    std::optional<RangeKernel> likelihood{};
    /// The heaviest surface of each ray is rendered (docs/method.md M13): hits no farther
    /// than this behind the one before are one, metres.
    std::optional<float> mode_gap_m{};

    /// Returns whether a forward pass writes a RenderedSurface for each ray.
    bool has_surfaces() const { return normals || mode_gap_m; }
};

/// Threads that trace a batch: whole tiles of 16 x 2 rays over an image, some of them
/// beside it; else one a ray.
std::size_t trace_threads(const RayBatch& batch);

/// The first hits of each ray of a batch, as the forward pass blended them, so that the
/// backward pass need not search them again.
struct KeptHits {
    Array<shared::Hit> hits;    ///< [ceil(n_threads / 4), per_ray, 4]
    std::uint32_t per_ray = 0;  ///< what a ray has behind them is searched again

    /// @param n_threads  that trace the largest batch
    KeptHits(Device& device, std::size_t n_threads, std::uint32_t hits_per_ray)
        : hits(device, side_by_side(n_threads) * hits_per_ray, "kept hits"), per_ray(hits_per_ray) {}
    /// As many threads, in whole groups whose hits lie side by side.
    static std::size_t side_by_side(std::size_t n_threads) {
        return (n_threads + RELIDAR_SIDE_BY_SIDE - 1) / RELIDAR_SIDE_BY_SIDE * RELIDAR_SIDE_BY_SIDE;
    }
    /// Whether there is room for those of a batch.
    bool hold(const RayBatch& batch) const {
        return side_by_side(trace_threads(batch)) * per_ray <= hits.size();
    }
};

/// How many hits of a ray should be kept where `n_overfull` rays had more than the
/// `per_ray` that are: twice as many while there are such rays, for a GPU waits for the
/// few that it searches again as long as for all others; but at most 256 (4 kB a ray), or
/// as many as now.
std::uint32_t kept_hits_wanted(std::uint32_t per_ray, std::uint64_t n_overfull);

/// A batch that has been rendered, as losses compare it and the backward pass
/// differentiates it.
struct RenderedBatch {
    RayBatch rays;
    const Array<shared::RenderedRay>* rendered = nullptr;  ///< [n_rays] of ForwardPass::run
    /// [n_rays] dL/d(rendered): losses write it, the backward pass reads it
    Array<shared::RayGradient>* upstream = nullptr;
    const KeptHits* kept = nullptr;  ///< of the same ForwardPass::run, or null
    /// [n_rays] of the same ForwardPass::run, or null without TraceOptions::has_surfaces()
    const Array<shared::RenderedSurface>* surfaces = nullptr;
};

/// Rays as kernels read them.
std::vector<DeviceRay> to_device_rays(const WorldRays& rays);

}  // namespace relidar
