// SPDX-License-Identifier: Apache-2.0
// Binding of gpu/sum_rows: about as many blocks as rows a block, then the blocks.
#include "gpu/sum_rows.hpp"

#include <cmath>

#include "core/assert.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

std::uint32_t rows_a_block(std::uint32_t n) { return static_cast<std::uint32_t>(std::ceil(std::sqrt(double(n)))); }

}  // namespace

SumRows::SumRows(Device& device, std::uint32_t most, std::uint32_t width)
    : most_(most), width_(width), blocks_(device, std::size_t(rows_a_block(most)) * width, "sums of blocks"), kernel_(device, "gpu/sum_rows") {}

void SumRows::add(Stream& stream, std::uint64_t rows, std::uint32_t n, std::uint64_t sums) {
    if (n == 0) return;
    RELIDAR_ASSERT_LE(n, most_);
    const std::uint32_t block = rows_a_block(n), n_blocks = (n - 1) / block + 1;
    run(stream, kernel_, std::size_t(n_blocks) * width_, {rows, blocks_.address(), n, width_, block, n_blocks, 0u});
    run(stream, kernel_, width_, {blocks_.address(), sums, n_blocks, width_, n_blocks, 1u, 1u});
}

}  // namespace relidar
