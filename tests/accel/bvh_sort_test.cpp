// SPDX-License-Identifier: Apache-2.0
// accel/bvh_sort_count, bvh_sort_scan, bvh_sort_scatter: a stable sort, against std::stable_sort.
#include <algorithm>
#include <numeric>
#include <random>

#include "accel/bvh_sort.hpp"
#include "gpu/stream.hpp"

#include "../support/device.hpp"

namespace relidar {
namespace {

class BvhSort : public test::DeviceTest {
protected:
    /// Sorts on the device by the low bits. @return order of the values 0, 1, 2, ...
    std::vector<std::uint32_t> sorted(const std::vector<std::uint64_t>& keys, std::uint32_t key_bits) {
        const auto n = static_cast<std::uint32_t>(keys.size());
        std::vector<glm::uvec2> words;
        for (const std::uint64_t key : keys) words.push_back({static_cast<std::uint32_t>(key), static_cast<std::uint32_t>(key >> 32)});
        std::vector<std::uint32_t> values(n);
        std::iota(values.begin(), values.end(), 0u);
        Array<glm::uvec2> from_keys(device(), std::span<const glm::uvec2>(words), "keys"), other_keys(device(), n, "keys");
        Array<std::uint32_t> from_values(device(), std::span<const std::uint32_t>(values), "values"), other_values(device(), n, "values");
        PairSort sort(device(), n);
        Stream stream(device());
        const SortPairs result = sort.sort(stream, {from_keys.address(), from_values.address()}, {other_keys.address(), other_values.address()}, n, key_bits);
        stream.finish();
        return result.values == from_values.address() ? from_values.download() : other_values.download();
    }

    void compare(const std::vector<std::uint64_t>& keys, std::uint32_t key_bits) {
        const std::uint64_t mask = key_bits == 64 ? ~std::uint64_t(0) : (std::uint64_t(1) << (key_bits + 7) / 8 * 8) - 1;
        std::vector<std::uint32_t> expected(keys.size());
        std::iota(expected.begin(), expected.end(), 0u);
        std::stable_sort(expected.begin(), expected.end(), [&](std::uint32_t a, std::uint32_t b) { return (keys[a] & mask) < (keys[b] & mask); });
        EXPECT_EQ(sorted(keys, key_bits), expected) << keys.size() << " keys of " << key_bits << " bits";
    }
};

TEST_F(BvhSort, EqualsStableSort) {
    std::mt19937_64 random(1);
    for (const std::uint32_t n : {1u, 2u, 31u, 256u, 4095u, 4096u, 4097u, 100'003u})
        for (const std::uint32_t bits : {8u, 40u, 64u}) {
            std::vector<std::uint64_t> keys(n);
            for (std::uint64_t& key : keys) key = random();
            compare(keys, bits);
        }
}

TEST_F(BvhSort, KeepsTheOrderOfEqualKeys) {
    std::mt19937_64 random(2);
    for (const std::uint64_t different : {1u, 2u, 3u, 300u}) {
        std::vector<std::uint64_t> keys(20'000);
        for (std::uint64_t& key : keys) key = random() % different * 0x0101'0000'0001ull;
        compare(keys, 47);
    }
}

TEST_F(BvhSort, SortedAndReversedKeys) {
    std::vector<std::uint64_t> keys(10'000);
    std::iota(keys.begin(), keys.end(), 0xffff'0000ull);   // the carry crosses the words
    compare(keys, 40);
    std::reverse(keys.begin(), keys.end());
    compare(keys, 40);
}

}  // namespace
}  // namespace relidar
