// SPDX-License-Identifier: Apache-2.0
// Binding of densify/sum_blocks and densify/scan_blocks: sums up the levels, starts down again.
#include "densify/prefix_sum.hpp"

#include "gpu/stream.hpp"

namespace relidar {

namespace {

std::size_t blocks_of(std::size_t n) { return (n + RELIDAR_DENSIFY_BLOCK - 1) / RELIDAR_DENSIFY_BLOCK; }

}  // namespace

BlockScan::BlockScan(Device& device) : sum_blocks_(device, "densify/sum_blocks"), scan_blocks_(device, "densify/scan_blocks") {}

void BlockScan::reserve(Device& device, std::size_t n) {
    for (std::size_t level = 0; n > RELIDAR_DENSIFY_BLOCK; ++level) {
        n = blocks_of(n);
        if (levels_.size() == level) levels_.emplace_back();
        levels_[level].sums.reserve(device, n, "block sums");
        levels_[level].starts.reserve(device, n, "block starts");
    }
}

void BlockScan::run(Stream& stream, const Array<std::uint32_t>& values, const Array<std::uint32_t>& starts, std::uint32_t n) {
    std::vector<std::uint32_t> counts{n};   // of the values, then of the blocks of each level
    while (counts.back() > RELIDAR_DENSIFY_BLOCK) counts.push_back(static_cast<std::uint32_t>(blocks_of(counts.back())));
    const std::size_t depth = counts.size() - 1;
    const auto values_of = [&](std::size_t level) { return level == 0 ? values.address() : levels_[level - 1].sums.address(); };
    const auto starts_of = [&](std::size_t level) { return level == 0 ? starts.address() : levels_[level - 1].starts.address(); };
    for (std::size_t level = 0; level < depth; ++level)
        relidar::run(stream, sum_blocks_, blocks_of(counts[level]), {values_of(level), levels_[level].sums.address(), counts[level]});
    for (std::size_t level = depth + 1; level-- > 0;)
        relidar::run(stream, scan_blocks_, blocks_of(counts[level]), {values_of(level), level < depth ? starts_of(level + 1) : 0, starts_of(level), counts[level]});
}

}  // namespace relidar
