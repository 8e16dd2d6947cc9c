// SPDX-License-Identifier: Apache-2.0
// Records the passes of the radix sort.
#include "accel/bvh_sort.hpp"

#include <utility>

#include "core/assert.hpp"
#include "gpu/stream.hpp"

namespace relidar {

namespace {

constexpr Constant kWorkgroup{0u, RELIDAR_BVH_WORKGROUP};

std::uint32_t tiles_of(std::uint32_t n) { return (n + RELIDAR_BVH_TILE - 1) / RELIDAR_BVH_TILE; }

}  // namespace

static_assert(RELIDAR_BVH_WORKGROUP == RELIDAR_SORT_DIGITS, "a thread a digit");

PairSort::PairSort(Device& device, std::uint32_t n)
    : count_(device, "accel/bvh_sort_count", {kWorkgroup}),
      scan_(device, "accel/bvh_sort_scan", {kWorkgroup}),
      scatter_(device, "accel/bvh_sort_scatter", {kWorkgroup}),
      counts_(device, std::size_t(RELIDAR_SORT_DIGITS) * tiles_of(n), "sort counts"),
      totals_(device, RELIDAR_SORT_DIGITS, "sort totals") {}

SortPairs PairSort::sort(Stream& stream, SortPairs from, SortPairs other, std::uint32_t n, std::uint32_t key_bits) const {
    const std::uint32_t n_tiles = tiles_of(n);
    RELIDAR_ASSERT_LE(std::size_t(RELIDAR_SORT_DIGITS) * n_tiles, counts_.size());
    for (std::uint32_t pass = 0; pass < passes(key_bits); ++pass) {
        const shared::BvhSortParams params{from.keys, from.values, other.keys, other.values, counts_.address(), totals_.address(), n, n_tiles, 8 * pass};
        run(stream, count_, std::size_t(n_tiles) * RELIDAR_BVH_WORKGROUP, params);
        run(stream, scan_, 32 * RELIDAR_BVH_WORKGROUP, params);   // 32 workgroups of 4 to 32 subgroups each, for 256 digits
        run(stream, scatter_, std::size_t(n_tiles) * RELIDAR_BVH_WORKGROUP, params);
        std::swap(from, other);
    }
    return from;
}

}  // namespace relidar
