// SPDX-License-Identifier: Apache-2.0
// Prefix sums (gpu/scan_sums, scan_write), the stable sort (gpu/radix_count, radix_scatter) and gpu/sum_rows against the standard library: sizes around block, tile and level borders, counts
// known to the device alone, fewer keys than there is room for, strided counts; nothing is written beyond the arrays.
#include <algorithm>
#include <numeric>
#include <random>

#include "../support/device.hpp"
#include "gpu/prefix_sum.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/sum_rows.hpp"

namespace relidar {
namespace {

constexpr std::uint32_t kGuard = 0xdeadbeefu;

class Order : public test::DeviceTest {
protected:
    std::mt19937 random{7};
    std::vector<std::uint32_t> numbers(std::size_t n, std::uint32_t below) {
        std::vector<std::uint32_t> result(n);
        for (std::uint32_t& x : result) x = random() % below;
        return result;
    }
};

TEST_F(Order, PrefixSumsOfEverySize) {
    Stream stream(device());
    PrefixSum prefix_sum(device(), 200000);
    for (const std::uint32_t n : {1u, 2u, 255u, 256u, 257u, 65536u, 65537u, 200000u}) {
        const std::vector<std::uint32_t> counts = numbers(3 * n + 1, 50);
        const Array<std::uint32_t> in(device(), std::span<const std::uint32_t>(counts), "counts"), out(device(), std::vector<std::uint32_t>(n + 2, kGuard), "prefix");
        prefix_sum.run(stream, {in.address(), 1, 3}, out.address(), n);
        stream.finish();
        std::vector<std::uint32_t> expected(1, 0u);
        for (std::uint32_t i = 0; i < n; ++i) expected.push_back(expected.back() + counts[1 + 3 * i]);
        expected.push_back(kGuard);
        EXPECT_EQ(out.download(), expected) << n << " counts";
    }
}

TEST_F(Order, PrefixSumsInPlace) {
    Stream stream(device());
    const std::uint32_t n = 70000;
    PrefixSum prefix_sum(device(), n);
    std::vector<std::uint32_t> counts = numbers(n, 9);
    const Array<std::uint32_t> array(device(), std::span<const std::uint32_t>(counts), "counts");
    prefix_sum.run(stream, {array.address()}, array.address(), n);
    stream.finish();
    std::exclusive_scan(counts.begin(), counts.end(), counts.begin(), 0u);
    EXPECT_EQ(array.download(), counts);
}

TEST_F(Order, SortIsStable) {
    Stream stream(device());
    struct Case {
        std::uint32_t n, capacity, bits;
    };
    for (const auto& [n, capacity, bits] : {Case{0, 10, 4}, Case{1, 1, 1}, Case{128, 128, 6}, Case{129, 1000, 7}, Case{5000, 5000, 3}, Case{20000, 30000, 20}, Case{20000, 12345, 13}}) {
        RadixSort sort(device(), capacity);
        const std::vector<std::uint32_t> keys = numbers(capacity, 1u << bits);
        sort.keys().upload(keys);
        const Array<std::uint32_t> n_keys(device(), std::vector<std::uint32_t>{n}, "number of keys");
        const RadixSort::Sorted sorted = sort.run(stream, n_keys.address(), bits);
        stream.finish();
        const std::uint32_t n_sorted = std::min(n, capacity);
        std::vector<std::uint32_t> order(n_sorted), actual = sorted.values.download(), actual_keys = sorted.keys.download();
        std::iota(order.begin(), order.end(), 0u);
        std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) { return keys[a] < keys[b]; });
        actual.resize(n_sorted);
        EXPECT_EQ(actual, order) << n << " of " << capacity << " keys of " << bits << " bits";
        for (std::uint32_t i = 0; i < n_sorted; ++i) ASSERT_EQ(actual_keys[i], keys[order[i]]);
    }
}

TEST_F(Order, SumsOfRows) {
    Stream stream(device());
    for (const std::uint32_t n : {1u, 2u, 3u, 100u, 101u, 70001u}) {
        std::vector<float> rows;
        double expected[3] = {0.5, 0.5, 0.5};
        for (std::uint32_t i = 0; i < 3 * n; ++i) {
            rows.push_back(static_cast<float>(random() % 1000) / 1000.0f);
            expected[i % 3] += rows.back();
        }
        SumRows sum(device(), 70001, 3);
        const Array<float> in(device(), std::span<const float>(rows), "rows"), out(device(), std::vector<float>(3, 0.5f), "sums");
        sum.add(stream, in.address(), n, out.address());
        stream.finish();
        const std::vector<float> actual = out.download();
        for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(actual[k], expected[k], 1e-5 * expected[k]) << n << " rows, column " << k;
    }
}

}  // namespace
}  // namespace relidar
