// SPDX-License-Identifier: Apache-2.0
#include "gpu/prefix_sum.hpp"

#include "base/assert.hpp"
#include "gpu/stream.hpp"

namespace relidar {

PrefixSum::PrefixSum(Device& device)
    : sums_(device, "gpu/scan_sums", {kTileWorkgroup}, SubgroupRequirement::full),
      write_(device, "gpu/scan_write", {kTileWorkgroup}, SubgroupRequirement::full) {}

/// Each level has a tile per RELIDAR_TILE_SIZE numbers of the level below, until the
/// numbers fit into one tile.
void PrefixSum::reserve_scratch(Device& device, std::size_t max_count) {
    for (std::size_t level = 0; max_count > RELIDAR_TILE_SIZE; ++level) {
        max_count = count_tiles(max_count);
        if (levels_.size() == level) levels_.emplace_back();
        levels_[level].reserve(device, max_count, "sums of tiles");
    }
}

void PrefixSum::run(Stream& stream, const StridedCounts& counts,
                    Address<std::uint32_t, shared::ScanPrefix> prefix, std::uint32_t count,
                    Address<std::uint32_t, shared::ScanTotal> total) const {
    record_level(stream,
                 {.counts = counts.address,
                  .tile_sums = {},
                  .prefix = prefix,
                  .total = total,
                  .n = count,
                  .offset = counts.offset,
                  .stride = counts.stride},
                 0);
}

/// Records the kernels that compute prefix sums of `params.n` numbers. The first sums
/// each tile. Then these sums become prefix sums, which is the same task one level
/// higher. The last kernel adds them to the prefix sums within tiles; one tile needs only
/// this kernel.
void PrefixSum::record_level(Stream& stream, shared::ScanParams params, std::size_t level) const {
    if (params.n == 0) return;
    const std::size_t n_tiles = count_tiles(params.n), n_threads = n_tiles * RELIDAR_TILE_THREADS;
    if (n_tiles > 1) {
        RELIDAR_ASSERT_LE(level + 1, levels_.size());
        RELIDAR_ASSERT_LE(n_tiles, levels_[level].size());
        params.tile_sums = levels_[level].address();
        relidar::run(stream, sums_, n_threads, params);
        // In place: input and output are the array of the sums.
        record_level(stream,
                     {.counts = params.tile_sums.cast_tag<shared::ScanCounts>(),
                      .tile_sums = {},
                      .prefix = params.tile_sums.cast_tag<shared::ScanPrefix>(),
                      .total = {},
                      .n = static_cast<std::uint32_t>(n_tiles),
                      .offset = 0,
                      .stride = 1},
                     level + 1);
    }
    relidar::run(stream, write_, n_threads, params);
}

}  // namespace relidar
