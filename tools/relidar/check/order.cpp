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

/// Sorts random keys by their low 24 bits on the device. Returns true if keys and order
/// equal those of a stable sort on the CPU.
bool is_sorted_right(Device& device, std::uint32_t n_keys, std::uint32_t capacity) {
    const Words keys = random_words(capacity);
    const Array<std::uint32_t, shared::SortCount> count(device, Words{n_keys}, "number of keys");
    const Array<std::uint32_t, shared::SortKeys> first(device, std::span<const std::uint32_t>(keys), "keys"),
        second(device, capacity, "sorted keys");
    const Array<std::uint32_t, shared::SortOrder> first_order(device, capacity, "order"),
        second_order(device, capacity, "sorted order");
    const RadixSort sort(device, capacity, 1);
    Stream stream(device);
    sort.run(stream, {first.address(), first_order.address()}, {second.address(), second_order.address()}, 24,
             count.address());
    stream.submit_and_wait();
    Words order(n_keys);
    std::iota(order.begin(), order.end(), 0u);
    std::ranges::stable_sort(order, {}, [&](std::uint32_t index) { return keys[index] & 0xffffffu; });
    const Words sorted = second.download(), sorted_order = second_order.download();
    for (std::uint32_t i = 0; i < n_keys; ++i)
        if (sorted_order[i] != order[i] || sorted[i] != keys[order[i]]) return false;
    return true;
}

}  // namespace

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
    return {CheckResult::CheckOutcome::right, "exact"};
}

CheckResult check_radix_sort(CheckedDevice& tested) {
    Device& device = tested.default_device();
    if (!device.info().can_require_subgroup_size)
        return unsupported_check("the device does not report its subgroup size");
    const std::uint32_t most = device.info().type == "CPU" ? 1'000'000u : 10'000'000u;
    // The sort must ignore the memory behind the last key.
    for (const auto& [n_keys, capacity] :
         {std::pair{0u, 10u}, {1u, 1u}, {4097u, 4097u}, {12'345u, 30'000u}, {most, most}})
        if (!is_sorted_right(device, n_keys, capacity))
            return failed_check(fmt::format("{} keys are not sorted correctly", n_keys));
    return {CheckResult::CheckOutcome::right,
            fmt::format("all arrays of up to {} keys are sorted correctly", most)};
}

}  // namespace relidar::cli
