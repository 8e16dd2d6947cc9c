// SPDX-License-Identifier: Apache-2.0
// Computes exclusive prefix sums of counts on the device.
#pragma once

#include "gpu/kernel.hpp"
#include "gpu/shared/gpu.h"

namespace relidar {

/// Of kernels that process tiles of items.
inline constexpr SpecialisationConstant kTileWorkgroup{SpecialisationConstantId::WORKGROUP_SIZE,
                                                       RELIDAR_TILE_THREADS};

inline std::size_t count_tiles(std::size_t n_items) {
    return (n_items + RELIDAR_TILE_SIZE - 1) / RELIDAR_TILE_SIZE;
}

/// Number i is at index offset + i * stride.
struct StridedCounts {
    Address<std::uint32_t, shared::ScanCounts> address;
    std::uint32_t offset = 0;
    std::uint32_t stride = 1;
};

class PrefixSum {
public:
    explicit PrefixSum(Device& device);
    /// Frees the old memory, so no pending submission may use this object.
    void reserve_scratch(Device& device, std::size_t max_count);
    /// Submits kernels that compute prefix sums: prefix[i] is the sum of all counts
    /// before count i. `prefix` may be the same array as the counts. The total must fit
    /// into 32 bits.
    /// @param total address for the total sum, or null. It is not written if `count` is 0
    void run(Stream& stream, const StridedCounts& counts, Address<std::uint32_t, shared::ScanPrefix> prefix,
             std::uint32_t count, Address<std::uint32_t, shared::ScanTotal> total = {}) const;

private:
    Kernel<shared::ScanParams> sums_;   ///< computes the sum of each tile
    Kernel<shared::ScanParams> write_;  ///< computes the prefix sums within tiles
    /// Sums of tiles, one array per level. Level 0 has tiles of the input numbers, each
    /// higher level tiles of the level below.
    std::vector<Array<std::uint32_t, shared::ScanTileSums>> levels_;

    void record_level(Stream& stream, shared::ScanParams params, std::size_t level) const;
};

}  // namespace relidar
