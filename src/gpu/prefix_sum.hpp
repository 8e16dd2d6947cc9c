// SPDX-License-Identifier: Apache-2.0
// Exclusive prefix sums over counts on the device (gpu/scan_sums, gpu/scan_write).
#pragma once

#include "gpu/kernel.hpp"
#include "gpu/shared/gpu.h"

namespace relidar {

/// Counts as they lie in memory: element i at offset + i * stride.
struct StridedCounts {
    Address<std::uint32_t, shared::ScanCounts> address;
    std::uint32_t offset = 0;
    std::uint32_t stride = 1;
};

class PrefixSum {
public:
    explicit PrefixSum(Device& device);
    /// Makes room for n counts. Nothing may be in flight.
    void reserve(Device& device, std::size_t n);
    /// Records prefix[i] = sum of the counts before i, i < n; in place where prefix is
    /// the counts. The sum of all must fit into 32 bits.
    /// @param total  where the sum of all goes, if anywhere; not written where n is 0
    void run(Stream& stream, const StridedCounts& counts, Address<std::uint32_t, shared::ScanPrefix> prefix,
             std::uint32_t n, Address<std::uint32_t, shared::ScanTotal> total = {}) const;

private:
    Kernel<shared::ScanParams> sums_, write_;
    /// sums of tiles, then of tiles of those, ...
    std::vector<Array<std::uint32_t, shared::ScanTileSums>> levels_;

    void run_level(Stream& stream, shared::ScanParams params, std::size_t level) const;
};

}  // namespace relidar
