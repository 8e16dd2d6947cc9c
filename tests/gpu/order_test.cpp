// SPDX-License-Identifier: Apache-2.0
// Compares prefix sums (scan_sums, scan_write) and the stable sort (radix_count,
// radix_scan, radix_scatter) with the standard library. No value may be written beyond
// the arrays.
#include <numeric>
#include <random>

#include "gpu/prefix_sum.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/stream.hpp"
#include "support/device.hpp"

namespace relidar {
namespace {

constexpr std::uint32_t kGuard = 0xdeadbeefu;

using Words = std::vector<std::uint32_t>;

class PrefixSums : public test::DeviceTest {
protected:
    std::mt19937 random{7};
    Words numbers(std::size_t count, std::uint32_t below) {
        Words result(count);
        for (std::uint32_t& x : result) x = random() % below;
        return result;
    }
};

TEST_F(PrefixSums, OfEverySize) {
    Stream stream(device());
    PrefixSum prefix_sum(device());
    // sizes that need one to three levels
    for (const std::uint32_t n :
         {1u, 2u, 255u, 256u, 257u, 4095u, 4096u, 4097u, 200'000u, 4096u * 4096u + 1u}) {
        const std::uint32_t stride = n < 1'000'000 ? 3 : 1;
        const Words counts = numbers(std::size_t(stride) * n + 1, 50);
        const Array<std::uint32_t, shared::ScanCounts> in(device(), std::span<const std::uint32_t>(counts),
                                                          "counts");
        const Array<std::uint32_t, shared::ScanPrefix> out(device(), Words(n + 64, kGuard), "prefix");
        const Array<std::uint32_t, shared::ScanTotal> total(device(), Words(2, kGuard), "total");
        prefix_sum.reserve_scratch(device(), n);
        prefix_sum.run(stream, {in.address(), 1, stride}, out.address(), n, total.address());
        stream.submit_and_wait();
        Words expected;
        for (std::uint32_t i = 0; i < n; ++i) expected.push_back(counts[1 + stride * i]);
        const std::uint32_t sum = std::accumulate(expected.begin(), expected.end(), 0u);
        std::exclusive_scan(expected.begin(), expected.end(), expected.begin(), 0u);
        expected.resize(n + 64, kGuard);
        EXPECT_TRUE(out.download() == expected) << n << " counts";
        EXPECT_EQ(total.download(), (Words{sum, kGuard})) << n << " counts";
    }
}

TEST_F(PrefixSums, InPlace) {
    Stream stream(device());
    const std::uint32_t n = 70'000;
    PrefixSum prefix_sum(device());
    prefix_sum.reserve_scratch(device(), n);
    Words counts = numbers(n, 9);
    const Array<std::uint32_t, shared::ScanCounts> array(device(), std::span<const std::uint32_t>(counts),
                                                         "counts");
    prefix_sum.run(stream, {array.address()}, array.address().cast_tag<shared::ScanPrefix>(), n);
    stream.submit_and_wait();
    std::exclusive_scan(counts.begin(), counts.end(), counts.begin(), 0u);
    EXPECT_EQ(array.download(), counts);
}

class Sort : public test::DeviceTest {
protected:
    std::mt19937_64 random{1};
    std::vector<std::uint64_t> numbers(std::size_t count) {
        std::vector<std::uint64_t> result(count);
        for (std::uint64_t& x : result) x = random();
        return result;
    }

    /// @param n_keys number of keys, which only the device has. Keys beyond it must not
    /// move.
    void compare(const std::vector<std::uint64_t>& keys, std::uint32_t key_words, std::uint32_t key_bits,
                 std::optional<std::uint32_t> n_keys = {}) {
        const auto capacity = static_cast<std::uint32_t>(keys.size()),
                   n = std::min(n_keys.value_or(capacity), capacity);
        Words words;
        for (const std::uint64_t key : keys)
            for (std::uint32_t w = 0; w < key_words; ++w)
                words.push_back(static_cast<std::uint32_t>(key >> 32 * w));
        const Array<std::uint32_t, shared::SortCount> count(device(), Words{n_keys.value_or(0)}, "count");
        const Array<std::uint32_t, shared::SortKeys> first(device(), std::span<const std::uint32_t>(words),
                                                           "keys"),
            second(device(), Words(words.size(), kGuard), "keys");
        const Array<std::uint32_t, shared::SortOrder> first_order(device(), Words(capacity, kGuard), "order"),
            second_order(device(), Words(capacity, kGuard), "order");
        const RadixSort sort(device(), capacity, key_words);
        Stream stream(device());
        const SortBuffers result = sort.run(
            stream, {first.address(), first_order.address()}, {second.address(), second_order.address()},
            key_bits, n_keys ? count.address() : Address<std::uint32_t, shared::SortCount>());
        stream.submit_and_wait();

        const std::uint64_t mask =
            key_bits == 64 ? ~std::uint64_t(0) : (std::uint64_t(1) << (key_bits + 7) / 8 * 8) - 1;
        Words order(n), sorted;
        std::iota(order.begin(), order.end(), 0u);
        std::stable_sort(order.begin(), order.end(), [&](std::uint32_t left, std::uint32_t right) {
            return (keys[left] & mask) < (keys[right] & mask);
        });
        for (const std::uint32_t i : order)
            sorted.insert(sorted.end(), words.begin() + key_words * i, words.begin() + key_words * (i + 1));
        const bool swapped = RadixSort::pass_count(key_bits) % 2 == 1;
        EXPECT_EQ(result.keys, (swapped ? second : first).address());
        Words actual = (swapped ? second : first).download(),
              actual_order = (swapped ? second_order : first_order).download();
        const std::string what = std::to_string(n) + " of " + std::to_string(capacity) + " keys of " +
                                 std::to_string(key_bits) + " bits";
        EXPECT_TRUE(std::equal(sorted.begin(), sorted.end(), actual.begin())) << what;
        EXPECT_TRUE(std::equal(order.begin(), order.end(), actual_order.begin())) << what;
        EXPECT_EQ(Words(actual_order.begin() + n, actual_order.end()), Words(capacity - n, kGuard)) << what;
    }
};

TEST_F(Sort, EqualsStableSort) {
    for (const std::uint32_t n : {1u, 2u, 31u, 256u, 4095u, 4096u, 4097u, 100'003u}) {
        for (const std::uint32_t bits : {1u, 8u, 13u, 32u}) compare(numbers(n), 1, bits);
        for (const std::uint32_t bits : {8u, 40u, 64u}) compare(numbers(n), 2, bits);
    }
}

TEST_F(Sort, AsManyAsTheDeviceKnowsOf) {
    for (const auto& [n, capacity] :
         {std::pair{0u, 10u}, {1u, 5000u}, {4096u, 30'000u}, {12'345u, 30'000u}, {20'000u, 12'345u}})
        compare(numbers(capacity), 1, 20, n);
    compare(numbers(9000), 2, 48, 5000);
}

TEST_F(Sort, KeepsTheOrderOfEqualKeys) {
    for (const std::uint64_t different : {1u, 2u, 3u, 300u}) {
        std::vector<std::uint64_t> keys = numbers(20'000);
        for (std::uint64_t& key : keys) key = key % different * 0x0101'0000'0001ull;
        compare(keys, 2, 47);
    }
}

TEST_F(Sort, SortedAndReversedKeys) {
    std::vector<std::uint64_t> keys(10'000);
    std::iota(keys.begin(), keys.end(), 0xffff'0000ull);  // the carry crosses the two words of a key
    compare(keys, 2, 40);
    std::reverse(keys.begin(), keys.end());
    compare(keys, 2, 40);
}

}  // namespace
}  // namespace relidar
