// SPDX-License-Identifier: Apache-2.0
// Stable radix sort of keys on the device, with 8 bits per pass and three kernels per
// pass (gpu/radix_count, radix_scan, radix_scatter). The number of keys can be a value
// that only the device knows.
#pragma once

#include "gpu/kernel.hpp"
#include "gpu/shared/gpu.h"

namespace relidar {

/// Addresses of an array of keys and of their order.
struct SortSet {
    Address<std::uint32_t, shared::SortKeys> keys;    ///< [n,key_words] low word first
    Address<std::uint32_t, shared::SortOrder> order;  ///< [n] index of each key before the sort
};

class RadixSort {
public:
    /// Creates the sort and allocates about 1/4 byte per key.
    /// @param capacity  largest number of keys
    /// @param key_words  32-bit words of a key
    /// @throws DeviceError if the subgroup size is below 4, above 64, or varies
    RadixSort(Device& device, std::uint32_t capacity, std::uint32_t key_words);
    std::uint32_t capacity() const { return capacity_; }

    /// Returns the number of passes for keys of `key_bits` bits. After an odd number of
    /// passes the sorted keys are in the other set.
    static std::uint32_t passes(std::uint32_t key_bits) { return key_bits > 8 ? (key_bits + 7) / 8 : 1; }
    /// Records a stable sort by the low key_bits bits. Overwrites both sets.
    /// @param from  keys to sort; its order is not read
    /// @param other  second set of the same size
    /// @param n_keys  address of the number of keys; if empty, `capacity` keys are
    /// sorted; keys beyond the capacity are ignored
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
