// SPDX-License-Identifier: Apache-2.0
// Computes exclusive prefix sums of counts on the device.
#pragma once

#include "gpu/kernel.hpp"
#include "gpu/shared/gpu.h"

namespace relidar {

/// View of counts in device memory. Count i is stored at index offset + i * stride.
struct StridedCounts {
    Address<std::uint32_t, shared::ScanCounts> address;
    std::uint32_t offset = 0;
    std::uint32_t stride = 1;
};

class PrefixSum {
public:
    explicit PrefixSum(Device& device);
    /// Allocates scratch memory for `count` counts. No pending submission may use this
    /// object, because the old memory is freed.
    void reserve(Device& device, std::size_t count);
    /// Submits kernels that compute prefix[i] for all i < count. prefix[i] is the sum of
    /// all counts before count i. `prefix` may be the same array as the counts. The total
    /// must fit into 32 bits.
    /// @param total address that receives the total sum, or null. Nothing is written if
    /// `count` is 0
    void run(Stream& stream, const StridedCounts& counts, Address<std::uint32_t, shared::ScanPrefix> prefix,
             std::uint32_t count, Address<std::uint32_t, shared::ScanTotal> total = {}) const;

private:
    Kernel<shared::ScanParams> sums_, write_;
    /// Sums of the tiles on each level. A tile of level 0 sums counts. A tile of each
    /// higher level sums tiles of the level below.
    std::vector<Array<std::uint32_t, shared::ScanTileSums>> levels_;

    void run_level(Stream& stream, shared::ScanParams params, std::size_t level) const;
};

}  // namespace relidar
