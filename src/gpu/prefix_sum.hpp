// SPDX-License-Identifier: Apache-2.0
// Computes exclusive prefix sums of counts on the device.
#pragma once

#include "gpu/kernel.hpp"
#include "gpu/shared/gpu.h"

namespace relidar {

/// View of counts in memory. Count i is at index offset + i * stride.
struct StridedCounts {
    Address<std::uint32_t, shared::ScanCounts> address;
    std::uint32_t offset = 0;
    std::uint32_t stride = 1;
};

class PrefixSum {
public:
    explicit PrefixSum(Device& device);
    /// Allocates scratch memory for n counts. No pending submission may use this object.
    void reserve(Device& device, std::size_t n);
    /// Submits kernels that compute prefix[i], the sum of all counts before count i, for
    /// i < n. `prefix` may be the same array as the counts. The total sum must fit into
    /// 32 bits.
    /// @param total address for the total sum, or null. Not written if n is 0.
    void run(Stream& stream, const StridedCounts& counts, Address<std::uint32_t, shared::ScanPrefix> prefix,
             std::uint32_t n, Address<std::uint32_t, shared::ScanTotal> total = {}) const;

private:
    Kernel<shared::ScanParams> sums_, write_;
    /// Sums of the tiles on each level. Level 0 sums the counts, level 1 sums level 0,
    /// and so on.
    std::vector<Array<std::uint32_t, shared::ScanTileSums>> levels_;

    void run_level(Stream& stream, shared::ScanParams params, std::size_t level) const;
};

}  // namespace relidar
