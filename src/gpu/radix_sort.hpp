// SPDX-License-Identifier: Apache-2.0
// Stable sort of keys on the device, which may know alone how many there are (gpu/radix_count, gpu/radix_scatter).
#pragma once

#include "gpu/prefix_sum.hpp"

namespace relidar {

class RadixSort {
public:
    /// @param capacity  keys there is room for: about 18 bytes each
    RadixSort(Device& device, std::uint32_t capacity);
    std::uint32_t capacity() const { return capacity_; }
    /// Where the keys are to be written before run().
    Array<std::uint32_t>& keys() { return keys_[0]; }

    struct Sorted {
        const Array<std::uint32_t>& keys;     ///< ascending
        const Array<std::uint32_t>& values;   ///< the place each key had before; equal keys keep their order
    };
    /// @param n_keys  device address of their number; keys beyond the capacity are left out
    /// @param n_bits  that keys have
    Sorted run(Stream& stream, std::uint64_t n_keys, std::uint32_t n_bits);

private:
    std::uint32_t capacity_, n_tiles_;
    Array<std::uint32_t> keys_[2], values_[2], table_;
    PrefixSum prefix_sum_;
    Kernel<shared::RadixSortParams> count_, scatter_;
};

}  // namespace relidar
