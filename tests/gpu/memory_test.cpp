// SPDX-License-Identifier: Apache-2.0
#include <random>

#include <relidar/gpu/out_of_memory.hpp>

#include "gpu/buffer.hpp"
#include "gpu/memory.hpp"
#include "support/device.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

TEST(FreeRanges, NeverOverlapAndMergeAgain) {
    constexpr std::uint64_t kBytes = 4096;
    std::mt19937 random(3);
    gpu::FreeRanges free(kBytes);
    std::vector<bool> used(kBytes, false);
    std::map<std::uint64_t, std::uint64_t> allocated_ranges;
    const auto mark = [&](std::uint64_t offset, std::uint64_t count, bool value) {
        for (std::uint64_t i = offset; i < offset + count; ++i) {
            ASSERT_EQ(used[i], !value) << "byte " << i;
            used[i] = value;
        }
    };
    std::size_t n_refused = 0;
    for (int step = 0; step < 20'000; ++step) {
        if (random() % 2 && !allocated_ranges.empty()) {
            const auto piece = std::next(allocated_ranges.begin(), random() % allocated_ranges.size());
            mark(piece->first, piece->second, false);
            free.release_range(piece->first, piece->second);
            allocated_ranges.erase(piece);
            continue;
        }
        const std::uint64_t n = 1 + random() % 400, alignment = std::uint64_t(1) << random() % 9;
        const auto offset = free.allocate_range(n, alignment);
        bool fits = false;
        for (std::uint64_t at = 0; at + n <= kBytes && !fits; at += alignment)
            fits = std::find(used.begin() + at, used.begin() + at + n, true) == used.begin() + at + n;
        ASSERT_EQ(offset.has_value(), fits) << n << " bytes aligned to " << alignment;
        n_refused += !fits;
        if (!offset) continue;
        ASSERT_EQ(*offset % alignment, 0u);
        ASSERT_LE(*offset + n, kBytes);
        mark(*offset, n, true);
        allocated_ranges[*offset] = n;
    }
    EXPECT_GT(n_refused, 100u) << "a full block was met";
    EXPECT_FALSE(free.is_all_free());
    for (const auto& [offset, n] : allocated_ranges) free.release_range(offset, n);
    EXPECT_TRUE(free.is_all_free());
    EXPECT_EQ(free.allocate_range(kBytes, 256), 0u) << "in one piece";
}

class GpuMemory : public test::DeviceTest {
protected:
    std::size_t n_blocks() { return device().impl().memory->block_count(); }
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
        stream.submit_and_wait();
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
        buffers.emplace_back(device(), gpu::DeviceMemoryAllocator::kBlockBytes / 3, "a third of a block");
    EXPECT_GE(n_blocks(), blocks + 3);
    buffers.emplace_back(device(), gpu::DeviceMemoryAllocator::kBlockBytes * 2, "a block of its own");
    const std::size_t most = n_blocks();
    buffers.pop_back();
    EXPECT_EQ(n_blocks(), most - 1);
    buffers.clear();
    EXPECT_LE(n_blocks(), blocks + 1) << "one is kept";
}

TEST_F(GpuMemory, WhatNoArrayCanHaveIsRefusedByName) {
    const auto& [limit, name] = device().impl().largest_buffer;
    const std::string parts = "a test of the impossible ... (" + std::string(name) + ")";
    for (const std::uint64_t n_bytes : {limit + 1, std::uint64_t(1) << 46})
        EXPECT_THAT([&] { Buffer(device(), n_bytes, "a test of the impossible"); },
                    testing::ThrowsMessage<DeviceError>(test::Names(parts)));
}

PFN_vkGetPhysicalDeviceMemoryProperties2 real_memory_properties = nullptr;
/// Reports a budget of 100 MiB for each heap. 40 MiB of it are used.
VKAPI_ATTR void VKAPI_CALL small_budget(VkPhysicalDevice physical,
                                        VkPhysicalDeviceMemoryProperties2* memory) {
    real_memory_properties(physical, memory);
    auto* budgets = static_cast<VkPhysicalDeviceMemoryBudgetPropertiesEXT*>(memory->pNext);
    for (std::uint32_t i = 0; i < memory->memoryProperties.memoryHeapCount; ++i)
        if (budgets) {
            budgets->heapBudget[i] = 100 << 20;
            budgets->heapUsage[i] = 40 << 20;
        } else memory->memoryProperties.memoryHeaps[i].size = 60 << 20;
}

/// Otherwise, the driver could end the process or move the memory of other programs.
TEST_F(GpuMemory, ArrayThatExceedsTheBudgetIsRefused) {
    if (device().allocated_bytes() > (8 << 20)) GTEST_SKIP() << "another test uses much memory";
    real_memory_properties = std::exchange(vkGetPhysicalDeviceMemoryProperties2, small_budget);
    const std::string parts = "61.0 MiB ... a large test array ... 60.0 MiB ... budget";
    EXPECT_THAT([&] { Buffer(device(), 61 << 20, "a large test array"); },
                testing::ThrowsMessage<OutOfDeviceMemory>(test::Names(parts)));
    EXPECT_NO_THROW(Buffer(device(), 40 << 20, "a smaller test array"));
    vkGetPhysicalDeviceMemoryProperties2 = real_memory_properties;
}

/// All bytes must be usable, also at the borders of the allocations.
TEST_F(GpuMemory, ArrayOfSeveralAllocations) {
    Device::Impl& impl = device().impl();
    if (!impl.binds_sparse) GTEST_SKIP() << "no sparse binding";
    constexpr std::uint64_t kPiece = 1 << 18;
    const std::uint64_t largest = std::exchange(impl.largest_allocation.n_bytes, kPiece);
    const std::uint64_t held = device().allocated_bytes();
    {
        constexpr std::uint32_t n = 5 * kPiece / 4 + 77;
        std::vector<std::uint32_t> values(n);
        for (std::uint32_t i = 0; i < n; ++i) values[i] = 2654435761u * i;
        const Array<std::uint32_t> from(device(), std::span<const std::uint32_t>(values), "several pieces"),
            to(device(), n, "several pieces");
        EXPECT_EQ(from.buffer().impl().memory.size(), 6u);
        EXPECT_GE(device().allocated_bytes() - held, 2ull * 4 * n);
        Stream stream(device());
        stream.fill(to, 7u);
        stream.copy(from.buffer(), to.buffer(), 4 * (n - 1));
        stream.submit_and_wait();
        values.back() = 7u;
        EXPECT_EQ(to.download(), values);
    }
    impl.largest_allocation.n_bytes = largest;
    EXPECT_EQ(device().allocated_bytes(), held);
}

}  // namespace
}  // namespace relidar
