// SPDX-License-Identifier: Apache-2.0
// Exclusive prefix sum of device integers in blocks of blocks, each summed by one thread. Private to densify.
#pragma once

#include <vector>

#include "gpu/kernel.hpp"
#include "shared/densify.h"

namespace relidar {

class BlockScan {
public:
    explicit BlockScan(Device& device);
    /// Makes room for n values. Nothing may be in flight.
    void reserve(Device& device, std::size_t n);
    /// Records starts[i] = values[0] + ... + values[i - 1]. The sum of all must fit into 32 bits.
    void run(Stream& stream, const Array<std::uint32_t>& values, const Array<std::uint32_t>& starts, std::uint32_t n);

private:
    struct Level {
        Array<std::uint32_t> sums, starts;   ///< of the blocks of the level below
    };
    Kernel<shared::SumBlocksParams> sum_blocks_;
    Kernel<shared::ScanBlocksParams> scan_blocks_;
    std::vector<Level> levels_;
};

}  // namespace relidar
