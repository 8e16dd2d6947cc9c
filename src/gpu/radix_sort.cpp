// SPDX-License-Identifier: Apache-2.0
// Binding of gpu/radix_count and gpu/radix_scatter: least significant digit first.
#include "gpu/radix_sort.hpp"

#include <algorithm>

#include "gpu/stream.hpp"

namespace relidar {

RadixSort::RadixSort(Device& device, std::uint32_t capacity)
    : capacity_(capacity),
      n_tiles_((std::max(capacity, 1u) - 1) / RELIDAR_SORT_TILE + 1),
      keys_{{device, capacity, "sort keys"}, {device, capacity, "sorted keys"}},
      values_{{device, capacity, "sort values"}, {device, capacity, "sorted values"}},
      table_(device, std::size_t(RELIDAR_SORT_DIGITS) * n_tiles_, "digit counts"),
      prefix_sum_(device, table_.size()),
      count_(device, "gpu/radix_count"),
      scatter_(device, "gpu/radix_scatter") {}

RadixSort::Sorted RadixSort::run(Stream& stream, std::uint64_t n_keys, std::uint32_t n_bits) {
    int from = 0;
    for (std::uint32_t shift = 0; shift == 0 || shift < n_bits; shift += RELIDAR_SORT_BITS) {
        const shared::RadixSortParams params{n_keys, keys_[from].address(), shift == 0 ? 0 : values_[from].address(), keys_[1 - from].address(), values_[1 - from].address(),
                                             table_.address(), capacity_, n_tiles_, shift};
        relidar::run(stream, count_, n_tiles_, params);
        prefix_sum_.run(stream, {table_.address()}, table_.address(), static_cast<std::uint32_t>(table_.size()));
        relidar::run(stream, scatter_, n_tiles_, params);
        from = 1 - from;
    }
    return {keys_[from], values_[from]};
}

}  // namespace relidar
