// SPDX-License-Identifier: Apache-2.0
// Stable radix sort of keys on the device, which may know alone how many there are: 8
// bits a pass, three kernels a pass (gpu/radix_count, radix_scan, radix_scatter).
#pragma once

#include "gpu/kernel.hpp"
#include "gpu/shared/gpu.h"

namespace relidar {

/// Addresses of one set of keys.
struct SortSet {
    Address<std::uint32_t, shared::SortKeys> keys;    ///< [n,key_words] low word first
    Address<std::uint32_t, shared::SortOrder> order;  ///< [n] the place each key had before
};

class RadixSort {
public:
    /// @param capacity  keys at most: about 1/4 byte each @param key_words  32-bit words
    /// of a key
    /// @throws DeviceError where subgroups have fewer than 4 lanes, more than 64, or a
    /// number that varies
    RadixSort(Device& device, std::uint32_t capacity, std::uint32_t key_words);
    std::uint32_t capacity() const { return capacity_; }

    /// Passes that keys of so many bits take. After an odd number the sorted keys lie in
    /// the other set.
    static std::uint32_t passes(std::uint32_t key_bits) { return key_bits > 8 ? (key_bits + 7) / 8 : 1; }
    /// Records a sort by the low key_bits bits; equal keys keep their order. Both sets
    /// are overwritten.
    /// @param from    its order is not read
    /// @param n_keys  where their number is; nowhere = the capacity; keys beyond the
    /// capacity are left out
    /// @return the set that holds the sorted keys
    SortSet run(Stream& stream, SortSet from, SortSet other, std::uint32_t key_bits,
                Address<std::uint32_t, shared::SortCount> n_keys = {}) const;
    std::uint64_t memory_bytes() const {
        return counts_.buffer().size_bytes() + totals_.buffer().size_bytes();
    }

private:
    std::uint32_t capacity_;
    Kernel<shared::RadixSortParams> count_, scan_, scatter_;
    Array<std::uint32_t, shared::DigitCounts> counts_;  ///< [RELIDAR_SORT_DIGITS, tiles]
    Array<std::uint32_t, shared::DigitTotals> totals_;  ///< [RELIDAR_SORT_DIGITS]
};

}  // namespace relidar
