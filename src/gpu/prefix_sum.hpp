// SPDX-License-Identifier: Apache-2.0
// Exclusive prefix sums of counts on the device (kernels gpu/scan_sums and
// gpu/scan_write).
#pragma once

#include "gpu/kernel.hpp"
#include "gpu/shared/gpu.h"

namespace relidar {

/// An array of counts with a stride: element i is at offset + i * stride.
struct StridedCounts {
    Address<std::uint32_t, shared::ScanCounts> address;
    std::uint32_t offset = 0;
    std::uint32_t stride = 1;
};

class PrefixSum {
public:
    explicit PrefixSum(Device& device);
    /// Allocates memory for n counts. No submitted work may use the old memory.
    void reserve(Device& device, std::size_t n);
    /// Records the computation prefix[i] = sum of the counts before i, for i < n.
    /// `prefix` may be the array of counts. The sum of all counts must fit into 32 bits.
    /// @param total  address that receives the sum of all counts, or empty; not written
    /// if n is 0
    void run(Stream& stream, const StridedCounts& counts, Address<std::uint32_t, shared::ScanPrefix> prefix,
             std::uint32_t n, Address<std::uint32_t, shared::ScanTotal> total = {}) const;

private:
    Kernel<shared::ScanParams> sums_, write_;
    /// Sums of tiles, then sums of tiles of these sums, and so on.
    std::vector<Array<std::uint32_t, shared::ScanTileSums>> levels_;

    void run_level(Stream& stream, shared::ScanParams params, std::size_t level) const;
};

}  // namespace relidar
