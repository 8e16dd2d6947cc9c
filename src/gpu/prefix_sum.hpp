// SPDX-License-Identifier: Apache-2.0
// Prefix sums over counts on the device (gpu/scan_sums, gpu/scan_write).
#pragma once

#include "gpu/kernel.hpp"
#include "shared/gpu.h"

namespace relidar {

/// Counts as they lie in memory: element i at offset + i * stride.
struct StridedCounts {
    std::uint64_t address = 0;
    std::uint32_t offset = 0;
    std::uint32_t stride = 1;
};

class PrefixSum {
public:
    /// @param most  elements of the longest array
    PrefixSum(Device& device, std::size_t most);
    /// prefix[i] = sum of the counts before i, i = 0..n; in place (stride 1) prefix[n] is not written.
    void run(Stream& stream, const StridedCounts& counts, std::uint64_t prefix, std::uint32_t n);

private:
    Kernel<shared::ScanParams> sums_, write_;
    std::vector<Array<std::uint32_t>> levels_;   ///< block sums, then sums of those, ...

    void run_level(Stream& stream, const StridedCounts& counts, std::uint64_t prefix, std::uint32_t n, std::size_t level);
};

}  // namespace relidar
