// SPDX-License-Identifier: Apache-2.0
#include "gpu/radix_sort.hpp"

#include "base/fail.hpp"
#include "gpu/prefix_sum.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

// One subgroup of 32 lanes for each of the 256 digit values. Subgroups of 64 lanes
// process two values, and some of fewer lanes have no work.
constexpr std::uint32_t kScanThreads = 32 * RELIDAR_TILE_THREADS;

}  // namespace

static_assert(RELIDAR_TILE_THREADS == RELIDAR_SORT_DIGITS, "a thread a digit");
static_assert(RELIDAR_SORT_DIGITS == 1u << RELIDAR_SORT_BITS && RELIDAR_SORT_BITS == 8, "as passes() counts");

RadixSort::RadixSort(Device& device, std::uint32_t max_keys, std::uint32_t words_per_key)
    : capacity_(max_keys),
      count_(device, "gpu/radix_count",
             {kTileWorkgroup, {SpecialisationConstantId::KEY_WORDS, words_per_key}},
             SubgroupRequirement::full),
      scan_(device, "gpu/radix_scan", {kTileWorkgroup}, SubgroupRequirement::full),
      scatter_(device, "gpu/radix_scatter",
               {kTileWorkgroup, {SpecialisationConstantId::KEY_WORDS, words_per_key}},
               SubgroupRequirement::full),
      counts_(device, RELIDAR_SORT_DIGITS * count_tiles(max_keys), "sort counts"),
      totals_(device, RELIDAR_SORT_DIGITS, "sort totals") {
    // The kernels count and rank keys with operations of full subgroups of a known size.
    if (const int lanes = device.info().subgroup_size; lanes < 4 || lanes > 64)
        fail<DeviceError>("cannot sort on the device {}: it has subgroups of {} lanes, expected 4 to 64",
                          device.info().name, lanes);
    if (!device.info().can_require_subgroup_size)
        fail<DeviceError>(
            "cannot sort on the device {}: the size of its subgroups varies, and it lacks "
            "subgroupSizeControl or computeFullSubgroups",
            device.info().name);
}

SortBuffers RadixSort::run(Stream& stream, SortBuffers input, SortBuffers scratch, std::uint32_t key_bits,
                           Address<std::uint32_t, shared::SortCount> n_keys) const {
    const std::size_t n_threads = count_tiles(capacity_) * RELIDAR_TILE_THREADS;
    // Each pass sorts by 8 bits (a digit), from the lowest to the highest. Its kernels
    // count the keys of each tile by their digit, sum these counts over the tiles, and
    // move the keys. Equal digits keep their order.
    for (std::uint32_t pass = 0; pass < pass_count(key_bits); ++pass) {
        const shared::RadixSortParams params{
            .n_keys = n_keys,
            .keys = input.keys,
            // Without an order, the first pass uses the indices 0, 1, 2, ...
            .order = pass == 0 ? Address<std::uint32_t, shared::SortOrder>() : input.order,
            .sorted_keys = scratch.keys,
            .sorted_order = scratch.order,
            .counts = counts_.address(),
            .totals = totals_.address(),
            .capacity = capacity_,
            .shift = RELIDAR_SORT_BITS * pass};
        relidar::run(stream, count_, n_threads, params);
        relidar::run(stream, scan_, kScanThreads, params);
        relidar::run(stream, scatter_, n_threads, params);
        std::swap(input, scratch);
    }
    return input;
}

}  // namespace relidar
