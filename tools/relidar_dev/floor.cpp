// SPDX-License-Identifier: Apache-2.0
#include "floor.hpp"

#include <bit>
#include <cmath>

namespace relidar::cli {
namespace {

using Sizes = const MemoryTrafficSizes&;

// Sizes in bytes of the data structures that kernels read and write (shaders/shared).
constexpr double kSurfelRecordBytes = 64, kGeometryBytes = 4 * (3 + 4 + 2 + 1), kNodeBytes = 80,
                 kRayBytes = 24, kRenderedBytes = 36, kTargetBytes = 12, kUpstreamBytes = 20,
                 kStoredHitBytes = 16, kHitBytes = 16, kHitRecordBytes = 16, kRowIndexBytes = 4,
                 kMarkBytes = 4;
constexpr double kBoxBytes = 24, kCornersBytes = 48, kSortKeyBytes = 8, kIndexBytes = 4;
// Minimum number of BVH nodes per surfel. Leaves have 4 surfels and nodes have 8
// children, so n surfels need at least about n / 4 / 7 nodes.
constexpr double kFewestNodes = 1.0 / 28.0;

double sh_bytes(Sizes s) { return 4 * 3 * s.n_sh; }
double ray_sh_bytes(Sizes s) { return s.sh_per_surfel ? 0.0 : sh_bytes(s); }

/// Returns the bytes of a refit, which reads the boxes of surfels and updates all nodes.
double refit_bytes(Sizes s) {
    return s.n_surfels * (kBoxBytes + kIndexBytes) +
           kFewestNodes * s.n_surfels * (28 + kNodeBytes + kBoxBytes);
}

/// Returns the number of bytes that building the tree must read and write. The build
/// first computes a key of 39 bits plus the model number from each box, and sorts the
/// keys. For each 8-bit digit, the sort reads the keys twice and the values once, and
/// writes both. Then the build writes the binary tree, reads its topology, and writes the
/// leaf order and the wide nodes.
double build_bytes(Sizes s) {
    const double bits = 39 + std::bit_width(std::uint64_t(s.n_models) - 1);
    const double sort = std::ceil(bits / 8) * (3 * kSortKeyBytes + 2 * kIndexBytes);
    const double tree = kBoxBytes + kSortKeyBytes + kIndexBytes +
                        (kSortKeyBytes + kBoxBytes + 28 + kIndexBytes) + (kSortKeyBytes + kIndexBytes);
    return s.n_surfels * (kBoxBytes + 12 + kSortKeyBytes + kIndexBytes + sort + tree + kIndexBytes) +
           refit_bytes(s);
}

/// Returns the bytes of the backward trace. Gradients are either written per hit
/// (`gather`), or added to the surfels with atomics.
double backward_bytes(Sizes s) {
    const double sums = s.gather ? s.n_hits * (kHitRecordBytes + kRowIndexBytes)
                                 : s.n_touched * 2 * (kSurfelRecordBytes + ray_sh_bytes(s));
    return s.n_rays * (kRayBytes + kRenderedBytes + kUpstreamBytes) + s.n_stored_hits_read * kStoredHitBytes +
           s.n_touched * (kSurfelRecordBytes + ray_sh_bytes(s)) + sums;
}

/// Returns the memory traffic in bytes of the kernel that differentiates the activation
/// functions. The kernel reads the gradients of all surfels. For surfels with a gradient,
/// it also reads parameters and writes parameter gradients.
double activation_bytes(Sizes s) {
    const double sh = s.sh_per_surfel ? sh_bytes(s) : 0.0;
    return s.n_surfels * (kSurfelRecordBytes + kMarkBytes) + s.n_touched * 2 * (kGeometryBytes + sh);
}

/// Returns the number of bytes of one optimizer step (Adam). The kernel reads the
/// gradients that are not zero. It reads and writes the parameters and both moments.
double adam_bytes(Sizes s) {
    const double updated = s.only_touched ? s.n_touched : s.n_surfels;
    return s.n_surfels * kMarkBytes + (s.n_touched + 6 * updated) * (kGeometryBytes + sh_bytes(s));
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
     [](Sizes s) { return s.n_surfels * (kGeometryBytes + sh_bytes(s) + kSurfelRecordBytes); }},
    {"diff/accel/proxies", When::always,
     [](Sizes s) { return s.n_surfels * (kSurfelRecordBytes + (s.boxes ? kBoxBytes : kCornersBytes)); }},
    {"accel/build", When::software, build_bytes},
    {"accel/refit", When::software, refit_bytes},
    {"diff/forward/append", When::lists,
     [](Sizes s) { return s.n_rays * kRayBytes + s.n_touched * kSurfelRecordBytes + s.n_hits * kHitBytes; }},
    {"diff/forward/sort_hits", When::lists, [](Sizes s) { return 2 * s.n_hits * kHitBytes; }},
    {"diff/forward/blend", When::lists,
     [](Sizes s) {
         return s.n_rays * kRenderedBytes + s.n_hits * kHitBytes + s.n_hits_written * kStoredHitBytes +
                s.n_touched * (kSurfelRecordBytes + ray_sh_bytes(s));
     }},
    {"diff/forward/trace", When::chunks,
     [](Sizes s) {
         return s.n_rays * (kRayBytes + kRenderedBytes) + s.n_hits_written * kStoredHitBytes +
                s.n_touched * (kSurfelRecordBytes + ray_sh_bytes(s));
     }},
    {"diff/loss/image_loss", When::training,
     [](Sizes s) { return s.n_rays * (kRenderedBytes + kTargetBytes + kUpstreamBytes); }},
    {"fill", When::training,
     // 192: gradients of 48 coefficients of spherical harmonics
     [](Sizes s) { return s.n_surfels * (kSurfelRecordBytes + (s.sh_per_surfel ? 0.0 : 192.0)); }},
    {"diff/backward/trace", When::training, backward_bytes},
    {"backward/sort", When::gather,
     [](Sizes s) {
         // number of 8-bit digits that n_surfels different keys need
         const double n_digits = std::ceil(std::bit_width(std::uint64_t(s.n_surfels)) / 8.0);
         return s.n_hits * n_digits * (kRowIndexBytes + 2 * (kRowIndexBytes + kIndexBytes));
     }},
    {"diff/backward/gather", When::gather,
     [](Sizes s) {
         return s.n_hits * (kHitRecordBytes + kRowIndexBytes + kIndexBytes) +
                s.n_touched * 2 * (kSurfelRecordBytes + ray_sh_bytes(s));
     }},
    {"scene/activate_vjp", When::training, activation_bytes},
    {"diff/optimizer/adam", When::training, adam_bytes},
};

bool is_kernel_used(const KernelTraffic& row, Sizes s) {
    if (row.when == When::chunks || row.when == When::lists) return s.lists == (row.when == When::lists);
    return row.when == When::always || (row.when == When::software && s.software) ||
           (row.when == When::training && s.training) || (row.when == When::gather && s.training && s.gather);
}

}  // namespace

std::map<std::string, double> min_traffic_bytes(const MemoryTrafficSizes& s) {
    std::map<std::string, double> bytes;
    for (const KernelTraffic& row : kFloorRows)
        if (is_kernel_used(row, s)) bytes[row.kernel] = row.bytes(s);
    return bytes;
}

}  // namespace relidar::cli
