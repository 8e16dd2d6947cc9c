// SPDX-License-Identifier: Apache-2.0
// Tests memory blocks that many arrays share. Compares the ranges of a block with a map
// of its bytes. Also tests more arrays than the driver allows allocations, and arrays
// that are too large.
#include <algorithm>
#include <map>
#include <random>

#include <relidar/base/error.hpp>

#include "../support/device.hpp"
#include "gpu/context.hpp"
#include "gpu/memory.hpp"

namespace relidar {
namespace {

TEST(FreeRanges, NeverOverlapAndMergeAgain) {
    constexpr std::uint64_t kBytes = 4096;
    std::mt19937 random(3);
    gpu::FreeRanges free(kBytes);
    std::vector<bool> used(kBytes, false);
    std::map<std::uint64_t, std::uint64_t> taken;
    const auto mark = [&](std::uint64_t offset, std::uint64_t count, bool value) {
        for (std::uint64_t i = offset; i < offset + count; ++i) {
            ASSERT_EQ(used[i], !value) << "byte " << i;
            used[i] = value;
        }
    };
    std::size_t n_refused = 0;
    for (int step = 0; step < 20'000; ++step) {
        if (random() % 2 && !taken.empty()) {
            const auto piece = std::next(taken.begin(), random() % taken.size());
            mark(piece->first, piece->second, false);
            free.release(piece->first, piece->second);
            taken.erase(piece);
            continue;
        }
        const std::uint64_t n = 1 + random() % 400, alignment = std::uint64_t(1) << random() % 9;
        const auto offset = free.take(n, alignment);
        bool fits = false;
        for (std::uint64_t at = 0; at + n <= kBytes && !fits; at += alignment)
            fits = std::find(used.begin() + at, used.begin() + at + n, true) == used.begin() + at + n;
        ASSERT_EQ(offset.has_value(), fits) << n << " bytes aligned to " << alignment;
        n_refused += !fits;
        if (!offset) continue;
        ASSERT_EQ(*offset % alignment, 0u);
        ASSERT_LE(*offset + n, kBytes);
        mark(*offset, n, true);
        taken[*offset] = n;
    }
    EXPECT_GT(n_refused, 100u) << "a full block was met";
    EXPECT_FALSE(free.all_free());
    for (const auto& [offset, n] : taken) free.release(offset, n);
    EXPECT_TRUE(free.all_free());
    EXPECT_EQ(free.take(kBytes, 256), 0u) << "in one piece";
}

class GpuMemory : public test::DeviceTest {
protected:
    std::size_t n_blocks() { return get_impl(device()).memory->n_blocks(); }
};

TEST_F(GpuMemory, MoreArraysThanAllocations) {
    constexpr std::uint32_t kArrays = 5000;  // maxMemoryAllocationCount is 4096 on many drivers
    const std::size_t blocks = n_blocks();
    const std::uint64_t held = device().allocated_bytes();
    {
        std::vector<Array<std::uint32_t>> arrays;
        Stream stream(device());
        for (std::uint32_t i = 0; i < kArrays; ++i)
            stream.fill(arrays.emplace_back(device(), 1 + i % 1000, "one of many"), i);
        stream.finish();
        EXPECT_LE(n_blocks(), blocks + 2);
        for (std::uint32_t i = 0; i < kArrays; ++i)
            ASSERT_EQ(arrays[i].download(), std::vector<std::uint32_t>(1 + i % 1000, i)) << "array " << i;
    }
    EXPECT_EQ(device().allocated_bytes(), held);
}

TEST_F(GpuMemory, EmptyBlocksAreGivenBack) {
    const std::size_t blocks = n_blocks();
    std::vector<Buffer> buffers;
    for (int i = 0; i < 12; ++i)
        buffers.emplace_back(device(), gpu::MemoryPools::kBlockBytes / 3, "a third of a block");
    EXPECT_GE(n_blocks(), blocks + 3);
    buffers.emplace_back(device(), gpu::MemoryPools::kBlockBytes * 2, "a block of its own");
    const std::size_t most = n_blocks();
    buffers.pop_back();
    EXPECT_EQ(n_blocks(), most - 1);
    buffers.clear();
    EXPECT_LE(n_blocks(), blocks + 1) << "one is kept";
}

TEST_F(GpuMemory, WhatNoArrayCanHaveIsRefusedByName) {
    const auto& [limit, name] = get_impl(device()).largest_buffer;
    for (const std::uint64_t n_bytes : {limit + 1, std::uint64_t(1) << 46}) {
        try {
            const Buffer buffer(device(), n_bytes, "a test of the impossible");
            FAIL() << "expected DeviceError";
        } catch (const DeviceError& error) {
            const std::string text = error.what();
            EXPECT_NE(text.find("MiB for a test of the impossible"), std::string::npos) << text;
            EXPECT_NE(text.find(std::string(name) + " = "), std::string::npos) << text;
        }
    }
}

}  // namespace
}  // namespace relidar
