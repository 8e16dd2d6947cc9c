// SPDX-License-Identifier: Apache-2.0
#include "floor.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

namespace relidar::cli {
namespace {

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

double compute_sh_bytes_per_surfel(const MemoryTrafficSizes& sizes) { return 4 * 3 * sizes.n_sh; }
double compute_sh_bytes_for_per_ray_evaluation(const MemoryTrafficSizes& sizes) {
    return sizes.sh_per_surfel ? 0.0 : compute_sh_bytes_per_surfel(sizes);
}

double count_bvh_refit_bytes(const MemoryTrafficSizes& sizes) {
    return sizes.n_surfels * (kBox + kIndex) + kFewestNodes * sizes.n_surfels * (28 + kNode + kBox);
}

/// Returns the number of bytes that building the tree must read and write. The build
/// first computes a key of 39 bits plus the model number from each box, and sorts the
/// keys. For each 8-bit digit, the sort reads the keys twice and the values once, and
/// writes both. Then the build writes the binary tree, reads its topology, and writes the
/// leaf order and the wide nodes.
double count_bvh_build_bytes(const MemoryTrafficSizes& sizes) {
    const double bits = 39 + std::bit_width(static_cast<std::uint64_t>(sizes.n_models) - 1);
    const double sort = std::ceil(bits / 8) * (3 * kKey + 2 * kIndex);
    const double tree = kBox + kKey + kIndex + (kKey + kBox + 28 + kIndex) + (kKey + kIndex);
    return sizes.n_surfels * (kBox + 12 + kKey + kIndex + sort + tree + kIndex) +
           count_bvh_refit_bytes(sizes);
}

double count_backward_trace_bytes(const MemoryTrafficSizes& sizes) {
    const double sums =
        sizes.gather ? sizes.n_hits * (kHitRecord + kRow)
                     : sizes.n_touched * 2 * (kRecord + compute_sh_bytes_for_per_ray_evaluation(sizes));
    return sizes.n_rays * (kRay + kRendered + kUpstream) + sizes.n_stored_hits_read * kStoredHit +
           sizes.n_touched * (kRecord + compute_sh_bytes_for_per_ray_evaluation(sizes)) + sums;
}

/// Returns the memory traffic in bytes of the kernel that differentiates the activation
/// functions. The kernel reads the gradients of all surfels. For surfels with a gradient,
/// it also reads parameters and writes parameter gradients.
double count_activation_gradient_bytes(const MemoryTrafficSizes& sizes) {
    const double sh_bytes = sizes.sh_per_surfel ? compute_sh_bytes_per_surfel(sizes) : 0.0;
    return sizes.n_surfels * (kRecord + kMark) + sizes.n_touched * 2 * (kGeometry + sh_bytes);
}

/// Returns the number of bytes of one optimizer step (Adam). The kernel reads the
/// gradients that are not zero. It reads and writes the parameters and both moments.
double count_adam_step_bytes(const MemoryTrafficSizes& sizes) {
    const double updated = sizes.only_touched ? sizes.n_touched : sizes.n_surfels;
    return sizes.n_surfels * kMark +
           (sizes.n_touched + 6 * updated) * (kGeometry + compute_sh_bytes_per_surfel(sizes));
}

enum class KernelCondition { always, software, training, gather, chunks, lists };

struct KernelTraffic {
    const char* kernel;
    KernelCondition when;
    double (*bytes)(const MemoryTrafficSizes&);
};

/// Minimum memory traffic of each kernel in bytes. A tracing kernel must load each surfel
/// that any ray hits at least once. Only these surfels get a gradient, so their number is
/// `n_touched`, the number of surfels with a gradient.
constexpr KernelTraffic kFloorRows[] = {
    {"scene/activate", KernelCondition::always,
     [](const MemoryTrafficSizes& sizes) {
         return sizes.n_surfels * (kGeometry + compute_sh_bytes_per_surfel(sizes) + kRecord);
     }},
    {"diff/accel/proxies", KernelCondition::always,
     [](const MemoryTrafficSizes& sizes) {
         return sizes.n_surfels * (kRecord + (sizes.boxes ? kBox : kCorners));
     }},
    {"accel/build", KernelCondition::software, count_bvh_build_bytes},
    {"accel/refit", KernelCondition::software, count_bvh_refit_bytes},
    {"diff/forward/append", KernelCondition::lists,
     [](const MemoryTrafficSizes& sizes) {
         return sizes.n_rays * kRay + sizes.n_touched * kRecord + sizes.n_hits * kHit;
     }},
    {"diff/forward/sort_hits", KernelCondition::lists,
     [](const MemoryTrafficSizes& sizes) { return 2 * sizes.n_hits * kHit; }},
    {"diff/forward/blend", KernelCondition::lists,
     [](const MemoryTrafficSizes& sizes) {
         return sizes.n_rays * kRendered + sizes.n_hits * kHit + sizes.n_hits_written * kStoredHit +
                sizes.n_touched * (kRecord + compute_sh_bytes_for_per_ray_evaluation(sizes));
     }},
    {"diff/forward/trace", KernelCondition::chunks,
     [](const MemoryTrafficSizes& sizes) {
         return sizes.n_rays * (kRay + kRendered) + sizes.n_hits_written * kStoredHit +
                sizes.n_touched * (kRecord + compute_sh_bytes_for_per_ray_evaluation(sizes));
     }},
    {"diff/loss/image_loss", KernelCondition::training,
     [](const MemoryTrafficSizes& sizes) { return sizes.n_rays * (kRendered + kTarget + kUpstream); }},
    {"fill", KernelCondition::training,
     [](const MemoryTrafficSizes& sizes) {
         return sizes.n_surfels * (kRecord + (sizes.sh_per_surfel ? 0.0 : 192.0));
     }},
    {"diff/backward/trace", KernelCondition::training, count_backward_trace_bytes},
    {"backward/sort", KernelCondition::gather,
     [](const MemoryTrafficSizes& sizes) {
         // number of 8-bit digits that n_surfels different keys need
         const double n_digits = std::ceil(std::bit_width(static_cast<std::uint64_t>(sizes.n_surfels)) / 8.0);
         return sizes.n_hits * n_digits * (kRow + 2 * (kRow + kIndex));
     }},
    {"diff/backward/gather", KernelCondition::gather,
     [](const MemoryTrafficSizes& sizes) {
         return sizes.n_hits * (kHitRecord + kRow + kIndex) +
                sizes.n_touched * 2 * (kRecord + compute_sh_bytes_for_per_ray_evaluation(sizes));
     }},
    {"scene/activate_vjp", KernelCondition::training, count_activation_gradient_bytes},
    {"diff/optimizer/adam", KernelCondition::training, count_adam_step_bytes},
};

bool is_kernel_used(const KernelTraffic& row, const MemoryTrafficSizes& sizes) {
    if (row.when == KernelCondition::chunks || row.when == KernelCondition::lists)
        return sizes.lists == (row.when == KernelCondition::lists);
    return row.when == KernelCondition::always || (row.when == KernelCondition::software && sizes.software) ||
           (row.when == KernelCondition::training && sizes.training) ||
           (row.when == KernelCondition::gather && sizes.training && sizes.gather);
}

}  // namespace

std::map<std::string, double> compute_min_traffic_bytes_per_kernel(const MemoryTrafficSizes& sizes) {
    std::map<std::string, double> bytes;
    for (const KernelTraffic& row : kFloorRows)
        if (is_kernel_used(row, sizes)) bytes[row.kernel] = row.bytes(sizes);
    return bytes;
}

std::map<std::string, double> compute_cache_load_bytes_per_kernel(const MemoryTrafficSizes& sizes) {
    std::map<std::string, double> bytes;
    if (sizes.nodes_opened <= 0.0) return bytes;
    const double search = sizes.nodes_opened * kNode + sizes.surfels_tested * kRecord;
    const double shading = sizes.n_hits * (kRecord + compute_sh_bytes_for_per_ray_evaluation(sizes));
    if (sizes.lists) {
        bytes["diff/forward/append"] = search + sizes.n_hits * kHit;
        bytes["diff/forward/blend"] = shading + sizes.n_hits * kHit;
    } else {
        bytes["diff/forward/trace"] = search + shading;
    }
    if (!sizes.training) return bytes;
    // share of the hits that are not stored, so that the backward pass must search them
    // again
    const double searched_again = sizes.n_hits > 0.0 ? 1.0 - sizes.n_stored_hits_read / sizes.n_hits : 0.0;
    // Bytes that the kernel writes per hit. With `gather`, the kernel stores the
    // gradients of the hit. Otherwise, it adds 16 floats with atomics. It also adds the
    // gradients of spherical harmonics if they are evaluated per ray.
    const double sums =
        sizes.gather ? kHitRecord + kRow : kRecord + compute_sh_bytes_for_per_ray_evaluation(sizes);
    bytes["diff/backward/trace"] = searched_again * search + shading + sizes.n_hits * (kRecord + sums);
    return bytes;
}

double estimate_traversal_operation_count(const MemoryTrafficSizes& sizes) {
    return sizes.nodes_opened * kNodeOperations + sizes.surfels_tested * kSurfelOperations;
}

}  // namespace relidar::cli
