// SPDX-License-Identifier: Apache-2.0
#include "floor.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

namespace relidar::cli {
namespace {

// Sizes in bytes of the data structures that kernels read and write (shaders/shared).
constexpr double kRecord = 64, kGeometry = 4 * (3 + 4 + 2 + 1), kNode = 80, kRay = 24, kRendered = 36,
                 kTarget = 12, kUpstream = 20, kKeptHit = 16, kHit = 16, kHitRecord = 16, kRow = 4, kMark = 4;
constexpr double kBox = 24, kCorners = 48, kKey = 8, kIndex = 4;
// Minimum number of tree nodes per surfel. A node has 8 children, and a leaf has 4
// surfels.
constexpr double kFewestNodes = 1.0 / 28.0;
// Arithmetic operations per visited node and per tested surfel, counted in
// shaders/diff/traversal/software_bvh.glsl.
constexpr double kNodeOperations = 150, kSurfelOperations = 40;

double sh(const FloorSizes& s) { return 4 * 3 * s.n_sh; }
double sh_along_ray(const FloorSizes& s) { return s.sh_per_surfel ? 0.0 : sh(s); }
double sh_a_surfel(const FloorSizes& s) { return s.sh_per_surfel ? sh(s) : 0.0; }

/// Returns the number of 8-bit digits that are needed to number n different keys.
double digits(double n) { return std::ceil(std::bit_width(static_cast<std::uint64_t>(n)) / 8.0); }

double refit(const FloorSizes& s) {
    return s.n_surfels * (kBox + kIndex) + kFewestNodes * s.n_surfels * (28 + kNode + kBox);
}

/// Returns the number of bytes that building the tree must read and write. The build
/// first computes a key of 39 bits plus the model number from each box, and sorts the
/// keys. For each 8-bit digit, the sort reads the keys twice and the values once, and
/// writes both. Then the build writes the binary tree, reads its topology, and writes the
/// leaf order and the wide nodes.
double build(const FloorSizes& s) {
    const double bits = 39 + std::bit_width(static_cast<std::uint64_t>(s.n_models) - 1);
    const double sort = std::ceil(bits / 8) * (3 * kKey + 2 * kIndex);
    const double tree = kBox + kKey + kIndex + (kKey + kBox + 28 + kIndex) + (kKey + kIndex);
    return s.n_surfels * (kBox + 12 + kKey + kIndex + sort + tree + kIndex) + refit(s);
}

double backward_trace(const FloorSizes& s) {
    const double sums =
        s.gather ? s.n_hits * (kHitRecord + kRow) : s.n_touched * 2 * (kRecord + sh_along_ray(s));
    return s.n_rays * (kRay + kRendered + kUpstream) + s.n_hits_kept * kKeptHit +
           s.n_touched * (kRecord + sh_along_ray(s)) + sums;
}

/// Returns the number of bytes that the derivative of the activation functions must read
/// and write. The kernel reads the gradients of all records, and marks the surfels with a
/// gradient. For the marked surfels, it reads the parameters and writes their gradients.
double activate_vjp(const FloorSizes& s) {
    return s.n_surfels * (kRecord + kMark) + s.n_touched * 2 * (kGeometry + sh_a_surfel(s));
}

/// Returns the number of bytes of one optimizer step (Adam). The kernel reads the marks
/// and the nonzero gradients. It reads and writes the parameters and both moments.
double adam(const FloorSizes& s) {
    const double updated = s.only_touched ? s.n_touched : s.n_surfels;
    return s.n_surfels * kMark + (s.n_touched + 6 * updated) * (kGeometry + sh(s));
}

enum class When { always, software, training, gather, chunks, lists };

struct Row {
    const char* kernel;
    When when;
    double (*bytes)(const FloorSizes&);
};

/// Table with one row per kernel. Only surfels with a gradient are counted as hit,
/// because the kernels do not have to load other surfels.
constexpr Row kFloorRows[] = {
    {"scene/activate", When::always,
     [](const FloorSizes& s) { return s.n_surfels * (kGeometry + sh(s) + kRecord); }},
    {"diff/accel/proxies", When::always,
     [](const FloorSizes& s) { return s.n_surfels * (kRecord + (s.boxes ? kBox : kCorners)); }},
    {"accel/build", When::software, build},
    {"accel/refit", When::software, refit},
    {"diff/forward/append", When::lists,
     [](const FloorSizes& s) { return s.n_rays * kRay + s.n_touched * kRecord + s.n_hits * kHit; }},
    {"diff/forward/sort_hits", When::lists, [](const FloorSizes& s) { return 2 * s.n_hits * kHit; }},
    {"diff/forward/blend", When::lists,
     [](const FloorSizes& s) {
         return s.n_rays * kRendered + s.n_hits * kHit + s.n_hits_written * kKeptHit +
                s.n_touched * (kRecord + sh_along_ray(s));
     }},
    {"diff/forward/trace", When::chunks,
     [](const FloorSizes& s) {
         return s.n_rays * (kRay + kRendered) + s.n_hits_written * kKeptHit +
                s.n_touched * (kRecord + sh_along_ray(s));
     }},
    {"diff/loss/image_loss", When::training,
     [](const FloorSizes& s) { return s.n_rays * (kRendered + kTarget + kUpstream); }},
    {"fill", When::training,
     [](const FloorSizes& s) { return s.n_surfels * (kRecord + (s.sh_per_surfel ? 0.0 : 192.0)); }},
    {"diff/backward/trace", When::training, backward_trace},
    {"backward/sort", When::gather,
     [](const FloorSizes& s) { return s.n_hits * digits(s.n_surfels) * (kRow + 2 * (kRow + kIndex)); }},
    {"diff/backward/gather", When::gather,
     [](const FloorSizes& s) {
         return s.n_hits * (kHitRecord + kRow + kIndex) + s.n_touched * 2 * (kRecord + sh_along_ray(s));
     }},
    {"scene/activate_vjp", When::training, activate_vjp},
    {"diff/optimizer/adam", When::training, adam},
};

bool runs(const Row& row, const FloorSizes& s) {
    if (row.when == When::chunks || row.when == When::lists) return s.lists == (row.when == When::lists);
    return row.when == When::always || (row.when == When::software && s.software) ||
           (row.when == When::training && s.training) || (row.when == When::gather && s.training && s.gather);
}

}  // namespace

std::map<std::string, double> floor_bytes(const FloorSizes& sizes) {
    std::map<std::string, double> bytes;
    for (const Row& row : kFloorRows)
        if (runs(row, sizes)) bytes[row.kernel] = row.bytes(sizes);
    return bytes;
}

std::map<std::string, double> cache_bytes(const FloorSizes& s) {
    std::map<std::string, double> bytes;
    if (s.nodes_opened <= 0.0) return bytes;
    const double search = s.nodes_opened * kNode + s.surfels_tested * kRecord;
    const double shading = s.n_hits * (kRecord + sh_along_ray(s));
    if (s.lists) {
        bytes["diff/forward/append"] = search + s.n_hits * kHit;
        bytes["diff/forward/blend"] = shading + s.n_hits * kHit;
    } else {
        bytes["diff/forward/trace"] = search + shading;
    }
    if (!s.training) return bytes;
    // Share of the hits that are not stored. The backward pass must search these hits
    // again.
    const double searched_again = s.n_hits > 0.0 ? 1.0 - s.n_hits_kept / s.n_hits : 0.0;
    // If gradients are not gathered, each hit adds 16 floats with atomic operations.
    const double sums = s.gather ? kHitRecord + kRow : kRecord + sh_along_ray(s);
    bytes["diff/backward/trace"] = searched_again * search + shading + s.n_hits * (kRecord + sums);
    return bytes;
}

double search_operations(const FloorSizes& s) {
    return s.nodes_opened * kNodeOperations + s.surfels_tested * kSurfelOperations;
}

}  // namespace relidar::cli
