// SPDX-License-Identifier: Apache-2.0
#include "floor.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

namespace relidar::cli {
namespace {

using Sizes = const MemoryTrafficSizes&;

// Sizes in bytes of the data structures that kernels read and write (shaders/shared).
constexpr double kRecord = 64, kGeometry = 4 * (3 + 4 + 2 + 1), kNode = 80, kRay = 24, kRendered = 36,
                 kTarget = 12, kUpstream = 20, kStoredHit = 16, kHit = 16, kHitRecord = 16, kRow = 4,
                 kMark = 4;
constexpr double kBox = 24, kCorners = 48, kKey = 8, kIndex = 4;
// Minimum number of BVH nodes per surfel. Leaves have 4 surfels and nodes have 8
// children, so n surfels need at least about n / 4 / 7 nodes.
constexpr double kFewestNodes = 1.0 / 28.0;
// Arithmetic operations for each tree node that a ray visits, and for each surfel that it
// tests. Counted in shaders/diff/traversal/software_bvh.glsl.
constexpr double kNodeOperations = 150, kSurfelOperations = 40;

double sh_bytes(Sizes s) { return 4 * 3 * s.n_sh; }
double ray_sh_bytes(Sizes s) { return s.sh_per_surfel ? 0.0 : sh_bytes(s); }

double count_bvh_refit_bytes(Sizes s) {
    return s.n_surfels * (kBox + kIndex) + kFewestNodes * s.n_surfels * (28 + kNode + kBox);
}

/// Returns the number of bytes that building the tree must read and write. The build
/// first computes a key of 39 bits plus the model number from each box, and sorts the
/// keys. For each 8-bit digit, the sort reads the keys twice and the values once, and
/// writes both. Then the build writes the binary tree, reads its topology, and writes the
/// leaf order and the wide nodes.
double count_bvh_build_bytes(Sizes s) {
    const double bits = 39 + std::bit_width(static_cast<std::uint64_t>(s.n_models) - 1);
    const double sort = std::ceil(bits / 8) * (3 * kKey + 2 * kIndex);
    const double tree = kBox + kKey + kIndex + (kKey + kBox + 28 + kIndex) + (kKey + kIndex);
    return s.n_surfels * (kBox + 12 + kKey + kIndex + sort + tree + kIndex) + count_bvh_refit_bytes(s);
}

double count_backward_trace_bytes(Sizes s) {
    const double sums =
        s.gather ? s.n_hits * (kHitRecord + kRow) : s.n_touched * 2 * (kRecord + ray_sh_bytes(s));
    return s.n_rays * (kRay + kRendered + kUpstream) + s.n_stored_hits_read * kStoredHit +
           s.n_touched * (kRecord + ray_sh_bytes(s)) + sums;
}

/// Returns the memory traffic in bytes of the kernel that differentiates the activation
/// functions. The kernel reads the gradients of all surfels. For surfels with a gradient,
/// it also reads parameters and writes parameter gradients.
double count_activation_gradient_bytes(Sizes s) {
    const double sh = s.sh_per_surfel ? sh_bytes(s) : 0.0;
    return s.n_surfels * (kRecord + kMark) + s.n_touched * 2 * (kGeometry + sh);
}

/// Returns the number of bytes of one optimizer step (Adam). The kernel reads the
/// gradients that are not zero. It reads and writes the parameters and both moments.
double count_adam_step_bytes(Sizes s) {
    const double updated = s.only_touched ? s.n_touched : s.n_surfels;
    return s.n_surfels * kMark + (s.n_touched + 6 * updated) * (kGeometry + sh_bytes(s));
}

enum class When { always, software, training, gather, chunks, lists };

struct KernelTraffic {
    const char* kernel;
    When when;
    double (*bytes)(Sizes);
};

/// Minimum memory traffic of each kernel in bytes. A tracing kernel must load each surfel
/// that any ray hits at least once. Only these surfels get a gradient, so their number is
/// `n_touched`, the number of surfels with a gradient.
constexpr KernelTraffic kFloorRows[] = {
    {"scene/activate", When::always,
     [](Sizes s) { return s.n_surfels * (kGeometry + sh_bytes(s) + kRecord); }},
    {"diff/accel/proxies", When::always,
     [](Sizes s) { return s.n_surfels * (kRecord + (s.boxes ? kBox : kCorners)); }},
    {"accel/build", When::software, count_bvh_build_bytes},
    {"accel/refit", When::software, count_bvh_refit_bytes},
    {"diff/forward/append", When::lists,
     [](Sizes s) { return s.n_rays * kRay + s.n_touched * kRecord + s.n_hits * kHit; }},
    {"diff/forward/sort_hits", When::lists, [](Sizes s) { return 2 * s.n_hits * kHit; }},
    {"diff/forward/blend", When::lists,
     [](Sizes s) {
         return s.n_rays * kRendered + s.n_hits * kHit + s.n_hits_written * kStoredHit +
                s.n_touched * (kRecord + ray_sh_bytes(s));
     }},
    {"diff/forward/trace", When::chunks,
     [](Sizes s) {
         return s.n_rays * (kRay + kRendered) + s.n_hits_written * kStoredHit +
                s.n_touched * (kRecord + ray_sh_bytes(s));
     }},
    {"diff/loss/image_loss", When::training,
     [](Sizes s) { return s.n_rays * (kRendered + kTarget + kUpstream); }},
    {"fill", When::training,
     [](Sizes s) { return s.n_surfels * (kRecord + (s.sh_per_surfel ? 0.0 : 192.0)); }},
    {"diff/backward/trace", When::training, count_backward_trace_bytes},
    {"backward/sort", When::gather,
     [](Sizes s) {
         // number of 8-bit digits that n_surfels different keys need
         const double n_digits = std::ceil(std::bit_width(static_cast<std::uint64_t>(s.n_surfels)) / 8.0);
         return s.n_hits * n_digits * (kRow + 2 * (kRow + kIndex));
     }},
    {"diff/backward/gather", When::gather,
     [](Sizes s) {
         return s.n_hits * (kHitRecord + kRow + kIndex) + s.n_touched * 2 * (kRecord + ray_sh_bytes(s));
     }},
    {"scene/activate_vjp", When::training, count_activation_gradient_bytes},
    {"diff/optimizer/adam", When::training, count_adam_step_bytes},
};

bool is_kernel_used(const KernelTraffic& row, Sizes s) {
    if (row.when == When::chunks || row.when == When::lists) return s.lists == (row.when == When::lists);
    return row.when == When::always || (row.when == When::software && s.software) ||
           (row.when == When::training && s.training) || (row.when == When::gather && s.training && s.gather);
}

}  // namespace

std::map<std::string, double> compute_min_traffic_bytes_per_kernel(const MemoryTrafficSizes& s) {
    std::map<std::string, double> bytes;
    for (const KernelTraffic& row : kFloorRows)
        if (is_kernel_used(row, s)) bytes[row.kernel] = row.bytes(s);
    return bytes;
}

std::map<std::string, double> compute_cache_load_bytes_per_kernel(const MemoryTrafficSizes& s) {
    std::map<std::string, double> bytes;
    if (s.nodes_opened <= 0.0) return bytes;
    const double search = s.nodes_opened * kNode + s.surfels_tested * kRecord;
    const double shading = s.n_hits * (kRecord + ray_sh_bytes(s));
    if (s.lists) {
        bytes["diff/forward/append"] = search + s.n_hits * kHit;
        bytes["diff/forward/blend"] = shading + s.n_hits * kHit;
    } else {
        bytes["diff/forward/trace"] = search + shading;
    }
    if (!s.training) return bytes;
    // share of the hits that are not stored, so that the backward pass must search them
    // again
    const double searched_again = s.n_hits > 0.0 ? 1.0 - s.n_stored_hits_read / s.n_hits : 0.0;
    // Bytes that the kernel writes per hit. With `gather`, the kernel stores the
    // gradients of the hit. Otherwise, it adds 16 floats with atomics. It also adds the
    // gradients of spherical harmonics if they are evaluated per ray.
    const double sums = s.gather ? kHitRecord + kRow : kRecord + ray_sh_bytes(s);
    bytes["diff/backward/trace"] = searched_again * search + shading + s.n_hits * (kRecord + sums);
    return bytes;
}

double estimate_traversal_operation_count(const MemoryTrafficSizes& s) {
    return s.nodes_opened * kNodeOperations + s.surfels_tested * kSurfelOperations;
}

}  // namespace relidar::cli
