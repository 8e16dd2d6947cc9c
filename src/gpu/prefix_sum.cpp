// SPDX-License-Identifier: Apache-2.0
// Binding of gpu/scan_sums and gpu/scan_write.
#include "gpu/prefix_sum.hpp"

#include "core/assert.hpp"
#include "gpu/stream.hpp"

namespace relidar {

PrefixSum::PrefixSum(Device& device, std::size_t most) : sums_(device, "gpu/scan_sums"), write_(device, "gpu/scan_write") {
    for (std::size_t n = most; n > RELIDAR_SCAN_BLOCK;) {
        n = (n - 1) / RELIDAR_SCAN_BLOCK + 1;
        levels_.emplace_back(device, n, "block sums");
    }
}

void PrefixSum::run(Stream& stream, const StridedCounts& counts, std::uint64_t prefix, std::uint32_t n) { run_level(stream, counts, prefix, n, 0); }

void PrefixSum::run_level(Stream& stream, const StridedCounts& counts, std::uint64_t prefix, std::uint32_t n, std::size_t level) {
    if (n == 0) return;
    const std::uint32_t n_blocks = (n - 1) / RELIDAR_SCAN_BLOCK + 1;
    std::uint64_t block_sums = 0;
    if (n_blocks > 1) {
        RELIDAR_ASSERT_LE(level + 1, levels_.size());
        block_sums = levels_[level].address();
        relidar::run(stream, sums_, n_blocks, {counts.address, block_sums, 0, n, counts.offset, counts.stride});
        run_level(stream, {block_sums}, block_sums, n_blocks, level + 1);
    }
    relidar::run(stream, write_, n_blocks, {counts.address, block_sums, prefix, n, counts.offset, counts.stride});
}

}  // namespace relidar
