// SPDX-License-Identifier: Apache-2.0
// Checks the GPU prefix sum and the GPU sort. The array sizes are close to the sizes of
// workgroups and tiles, because errors are most likely there.
#include <algorithm>
#include <numeric>
#include <random>
#include <vector>

#include <fmt/format.h>

#include "check/checks.hpp"
#include "gpu/prefix_sum.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/stream.hpp"

namespace relidar::cli {
namespace {

using Words = std::vector<std::uint32_t>;

Words random_words(std::size_t n_values) {
    std::mt19937 random(7);
    Words words(n_values);
    for (std::uint32_t& x : words) x = static_cast<std::uint32_t>(random());
    return words;
}

/// Sorts random keys by their low 24 bits on the device, because the sort can ignore high
/// bits. Returns true if keys and order equal those of a stable sort on the CPU.
/// @param capacity size of the arrays; the sort must ignore everything behind `n_keys`
bool is_sorted_right(Device& device, std::uint32_t n_keys, std::uint32_t capacity) {
    constexpr int kSortedBits = 24;
    constexpr std::uint32_t kSortedMask = (1u << kSortedBits) - 1;
    const Words keys = random_words(capacity);
    const Array<std::uint32_t, shared::SortCount> count(device, Words{n_keys}, "number of keys");
    const Array<std::uint32_t, shared::SortKeys> unsorted_keys(device, std::span<const std::uint32_t>(keys),
                                                               "keys"),
        sorted_keys(device, capacity, "sorted keys");
    const Array<std::uint32_t, shared::SortOrder> scratch_order(device, capacity, "order"),
        sorted_order(device, capacity, "sorted order");
    const RadixSort sort(device, capacity, 1);
    Stream stream(device);
    sort.run(stream, {unsorted_keys.address(), scratch_order.address()},
             {sorted_keys.address(), sorted_order.address()}, kSortedBits, count.address());
    // A pass sorts by 8 bits and writes to the other arrays. There are three passes, so
    // the result is in the second arrays.
    stream.submit_and_wait();

    Words expected_order(n_keys);
    std::iota(expected_order.begin(), expected_order.end(), 0u);
    std::ranges::stable_sort(expected_order, {}, [&](std::uint32_t i) { return keys[i] & kSortedMask; });
    const Words actual_keys = sorted_keys.download(), actual_order = sorted_order.download();
    for (std::uint32_t i = 0; i < n_keys; ++i)
        if (actual_order[i] != expected_order[i] || actual_keys[i] != keys[expected_order[i]]) return false;
    return true;
}

}  // namespace

/// Compares exclusive prefix sums of the device with exact sums.
CheckResult check_prefix_sum(CheckedDevice& tested) {
    Device& device = tested.default_device();
    PrefixSum prefix_sum(device);
    Stream stream(device);
    // Arrays within one tile of 4096 numbers, just larger, and with many tiles.
    for (const std::uint32_t n : {1u, 255u, 4096u, 4097u, 1'000'003u}) {
        Words counts = random_words(n);
        // Small numbers, so that the total fits into 32 bits.
        for (std::uint32_t& x : counts) x %= 1000u;
        const Array<std::uint32_t, shared::ScanCounts> in(device, std::span<const std::uint32_t>(counts),
                                                          "counts");
        const Array<std::uint32_t, shared::ScanPrefix> out(device, n, "prefix sums");
        prefix_sum.reserve_scratch(device, n);
        prefix_sum.run(stream, {in.address()}, out.address(), n);
        stream.submit_and_wait();
        std::exclusive_scan(counts.begin(), counts.end(), counts.begin(), 0u);
        if (out.download() != counts)
            return failed_check(fmt::format("found wrong prefix sums of {} numbers, expected exact sums", n));
    }
    return passed_check();
}

/// Compares the radix sort of the device with a stable sort on the CPU.
CheckResult check_radix_sort(CheckedDevice& tested) {
    Device& device = tested.default_device();
    if (!device.info().can_require_subgroup_size)
        return unsupported_check("the device does not report its subgroup size");
    const std::uint32_t most = device.info().type == "CPU" ? 1'000'000u : 10'000'000u;
    // No key, one key, just more than a tile of 4096 keys, memory behind the last key,
    // and many tiles.
    for (const auto& [n_keys, capacity] :
         {std::pair{0u, 10u}, {1u, 1u}, {4097u, 4097u}, {12'345u, 30'000u}, {most, most}})
        if (!is_sorted_right(device, n_keys, capacity))
            return failed_check(fmt::format("{} keys are not sorted correctly", n_keys));
    return passed_check(fmt::format("all arrays of up to {} keys are sorted correctly", most));
}

}  // namespace relidar::cli
