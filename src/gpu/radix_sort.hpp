// SPDX-License-Identifier: Apache-2.0
// Stable radix sort of keys on the device. The number of keys can be a result of earlier
// kernels. Each pass sorts by 8 bits and launches three kernels.
#pragma once

#include "gpu/kernel.hpp"
#include "gpu/shared/gpu.h"

namespace relidar {

struct SortBuffers {
    /// Keys [n,words_per_key]. The low word of a key is first.
    Address<std::uint32_t, shared::SortKeys> keys;
    Address<std::uint32_t, shared::SortOrder> order;  ///< Original index of each key, [n].
};

class RadixSort {
public:
    /// Creates the kernels, and scratch memory for `max_keys` keys (1/4 byte per key).
    /// @throws DeviceError if subgroups have fewer than 4 or more than 64 lanes, or their
    /// size is not constant
    RadixSort(Device& device, std::uint32_t max_keys, std::uint32_t words_per_key);
    std::uint32_t capacity() const { return capacity_; }

    /// 8 bits per pass. If the number is odd, the result is in the second set of arrays.
    static std::uint32_t pass_count(std::uint32_t key_bits) { return key_bits > 8 ? (key_bits + 7) / 8 : 1; }
    /// Submits kernels that sort keys by their low `key_bits` bits. Equal keys keep their
    /// order. Overwrites both sets of arrays.
    /// @param input keys to sort. The order array of this set is not read
    /// @param n_keys address of the number of keys. If null, the number equals the
    /// capacity. Keys beyond the capacity are ignored
    /// @return the set that contains the sorted keys
    SortBuffers run(Stream& stream, SortBuffers input, SortBuffers scratch, std::uint32_t key_bits,
                    Address<std::uint32_t, shared::SortCount> n_keys = {}) const;

private:
    std::uint32_t capacity_;
    Kernel<shared::RadixSortParams> count_, scan_, scatter_;
    /// Number of keys per digit and tile [RELIDAR_SORT_DIGITS, tiles].
    Array<std::uint32_t, shared::DigitCounts> counts_;
    /// Number of keys per digit [RELIDAR_SORT_DIGITS].
    Array<std::uint32_t, shared::DigitTotals> totals_;
};

}  // namespace relidar
