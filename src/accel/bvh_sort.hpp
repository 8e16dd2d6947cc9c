// SPDX-License-Identifier: Apache-2.0
// Stable radix sort of (key, value) pairs on the device: 8 bits a pass, three kernels a pass.
#pragma once

#include <relidar/gpu.hpp>

#include "gpu/kernel.hpp"
#include "shared/bvh_build.h"

namespace relidar {

/// Addresses of one set of pairs.
struct SortPairs {
    std::uint64_t keys = 0;     ///< [n,2] low and high word
    std::uint64_t values = 0;   ///< [n]
};

class PairSort {
public:
    /// Room for n pairs at most.
    PairSort(Device& device, std::uint32_t n);

    /// Passes that keys of so many bits take. After an odd number the pairs lie in the other set.
    static std::uint32_t passes(std::uint32_t key_bits) { return (key_bits + 7) / 8; }
    /// Records a sort by the low key_bits bits; pairs of equal keys keep their order. Both sets are overwritten.
    /// @return the set that holds the sorted pairs
    SortPairs sort(Stream& stream, SortPairs from, SortPairs other, std::uint32_t n, std::uint32_t key_bits) const;
    std::uint64_t memory_bytes() const { return counts_.buffer().size_bytes() + totals_.buffer().size_bytes(); }

private:
    Kernel<shared::BvhSortParams> count_, scan_, scatter_;
    Array<std::uint32_t> counts_;   ///< [256, tiles]
    Array<std::uint32_t> totals_;   ///< [256]
};

}  // namespace relidar
