// SPDX-License-Identifier: Apache-2.0
// Ray batches, ray tracing options, and data that the forward pass stores for the
// backward pass.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/diff/rays.h>
#include <relidar/gpu/stream.hpp>

namespace relidar {

struct WorldRays {
    std::vector<glm::vec3> origin;     ///< Origins, [n] metres.
    std::vector<glm::vec3> direction;  ///< Unit directions, [n].
    /// Firing times, [n] seconds after the reference time of the sweep. If empty, no
    /// instance moves during the sweep.
    std::vector<float> time_s = {};
    std::size_t size() const { return direction.size(); }
};

using shared::DeviceRay;

/// Batch of rays on the device. Ray k of the batch is rays[first + k * stride].
struct RayBatch {
    const Array<DeviceRay>* rays = nullptr;
    std::uint32_t first = 0;
    std::uint32_t stride = 1;
    std::uint32_t n_rays = 0;
    /// Number of columns if the rays form an image in row order, otherwise 0. n_rays must
    /// be a multiple of this number. Neighbouring threads trace tiles of 16 x 2 pixels of
    /// an image, because these rays visit the same tree nodes. Without an image, threads
    /// trace rays in list order.
    std::uint32_t columns = 0;
    /// Measured targets of the rays, with the same indices as `rays`. Used only with
    /// TraceOptions::likelihood. Null = no targets.
    const Array<shared::DeviceTarget>* targets = nullptr;
};

/// Method for traversing the software tree. `lane`: each thread traverses the tree for
/// its ray alone. `subgroup`: the threads of a GPU subgroup visit the same nodes
/// together.
enum class BvhTraversalMode { automatic, lane, subgroup };

/// Method for sorting the hits of a ray. `chunks`: the kernel inserts each hit into a
/// small sorted buffer. `lists`: the kernel appends all hits to a list in memory, which
/// is sorted afterwards.
enum class HitSortMethod { automatic, chunks, lists };

/// Function k(t) for the likelihood of a measured range z (docs/method.md M12): k(t) = 1
/// / (1 + ((t - z) / scale_m)^2).
struct RangeLikelihoodKernel {
    float scale_m = 0.05f;
};

/// Options for ray tracing. They affect speed and additional outputs, but not the
/// rendered image.
struct TraceOptions {
    int chunk = 16;  ///< Number of hits that are sorted at a time, 1..64.
    /// Traversal method of the software tree. automatic = the faster method for this type
    /// of device.
    BvhTraversalMode traversal_mode = BvhTraversalMode::automatic;
    /// Method for sorting the hits of each ray in the forward pass. `automatic` selects
    /// HitSortMethod::lists on a GPU and HitSortMethod::chunks on a CPU.
    HitSortMethod order = HitSortMethod::automatic;
    /// Only for HitSortMethod::lists: initial capacity of the hit list of each ray,
    /// 1..512 hits. A ray with more hits is rendered with HitSortMethod::chunks, which is
    /// slower. If this happens, later forward passes use lists with twice the capacity.
    int initial_list_capacity = 64;
    /// If true, computes a blended surface normal for each ray. Normals have no gradient.
    bool normals = false;
    /// If set, computes the likelihood of the measured range of each ray.
    std::optional<RangeLikelihoodKernel> likelihood{};
    /// If set, finds the surface with the largest total weight along each ray
    /// (docs/method.md M13). Consecutive hits belong to one surface if their distance is
    /// at most this value, metres.
    std::optional<float> mode_gap_m{};

    /// Returns true if the forward pass writes a normal and a surface distance for each
    /// ray.
    bool writes_surfaces() const { return normals || mode_gap_m; }
};

/// Returns the number of threads that trace a batch. An image is traced in tiles of 16 x
/// 2 pixels, so threads at its border may have no ray. Without an image, every ray has
/// one thread.
std::size_t count_threads(const RayBatch& batch);

/// First hits of each ray, stored by the forward pass. The backward pass reads these hits
/// instead of searching for them again.
struct StoredRayHits {
    /// Stored hits. The hits of two neighbouring threads alternate in memory,
    /// [ceil(n_threads / 2), hits_per_ray, 2].
    Array<shared::Hit> hits;
    /// Number of hits stored per ray. If a ray has more hits, the backward pass searches
    /// for the remaining hits again.
    std::uint32_t per_ray = 0;

    /// @param n_threads number of threads that trace the largest batch
    StoredRayHits(Device& device, std::size_t n_threads, std::uint32_t hits_per_ray)
        : hits(device, round_up_threads(n_threads) * hits_per_ray, "kept hits"), per_ray(hits_per_ray) {}
    /// Rounds a number of threads up to a multiple of RELIDAR_SIDE_BY_SIDE. The hits of
    /// that many neighbouring threads are interleaved in memory.
    static std::size_t round_up_threads(std::size_t n_threads) {
        return (n_threads + RELIDAR_SIDE_BY_SIDE - 1) / RELIDAR_SIDE_BY_SIDE * RELIDAR_SIDE_BY_SIDE;
    }
    bool can_store_hits(const RayBatch& batch) const {
        return round_up_threads(count_threads(batch)) * per_ray <= hits.size();
    }
};

/// Returns the number of hits to keep per ray, after `n_overflowed_rays` rays had more
/// than `hits_per_ray` hits. The number is doubled while such rays exist. Even a few of
/// these rays are expensive: on a GPU, their search takes as long as the search for all
/// rays. The result is at most 256 (4 kB per ray), or `hits_per_ray` if that is larger.
std::uint32_t grow_stored_hits(std::uint32_t hits_per_ray, std::uint64_t n_overflowed_rays);

/// Rendered batch with the arrays that the losses and the backward pass read and write.
struct RenderedBatch {
    RayBatch rays;
    const Array<shared::RenderedRay>* rendered = nullptr;
    /// Gradients dL/d(rendered) of all rays, [n_rays]. Losses write these gradients. The
    /// backward pass reads them.
    Array<shared::RayGradient>* upstream = nullptr;
    const StoredRayHits* stored_hits =
        nullptr;  ///< Hits that the forward pass has stored for this batch, or null.
    /// Surface normals and distances of this batch, [n_rays]. Null without
    /// TraceOptions::writes_surfaces().
    const Array<shared::RenderedSurface>* surfaces = nullptr;
};

/// Converts rays from host arrays to the struct that kernels read.
std::vector<DeviceRay> to_device_rays(const WorldRays& rays);

}  // namespace relidar
