// SPDX-License-Identifier: Apache-2.0
#include <numeric>
#include <random>

#include <relidar/gpu/out_of_memory.hpp>
#include "../base/codecs/temporary_folder.hpp"
#include "gpu/buffer.hpp"
#include "gpu/context.hpp"
#include "gpu/memory.hpp"
#include "support/device.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

class Gpu : public test::DeviceTest {};

TEST_F(Gpu, EveryDeviceIsDescribed) {
    const std::vector<DeviceInfo> devices = list_devices();
    ASSERT_FALSE(devices.empty());
    for (std::size_t i = 0; i < devices.size(); ++i) {
        EXPECT_EQ(devices[i].index, static_cast<int>(i));
        EXPECT_FALSE(devices[i].name.empty());
        EXPECT_EQ(devices[i].ray_query,
                  devices[i].why_not_ray_query.empty() && devices[i].why_not_usable.empty());
        // The compiler of SwiftShader would terminate the process.
        if (devices[i].driver.starts_with("SwiftShader")) {
            EXPECT_FALSE(devices[i].software);
        }
    }
}

class MissingDrivers : public TemporaryFolder {
protected:
    void add_render_node(const char* name, const char* vendor) const {
        std::filesystem::create_directories(folder / "dev/dri");
        std::filesystem::create_directories(folder / "sys/class/drm" / name / "device");
        put(folder / "dev/dri" / name, "");
        put(folder / "sys/class/drm" / name / "device/vendor", vendor);
    }
    std::vector<std::string> list(std::uint32_t vendor_id, const char* type) const {
        DeviceInfo device;
        device.vendor_id = vendor_id;
        device.type = type;
        return find_driverless({device}, folder);
    }
    static constexpr std::uint32_t kMesaCpu = 0x10005;  // VK_VENDOR_ID_MESA
};

TEST_F(MissingDrivers, NameTheirDeviceFile) {
    EXPECT_THAT(list(kMesaCpu, "CPU"), testing::IsEmpty()) << "no card";
    add_render_node("renderD128", "0x8086\n");
    EXPECT_THAT(list(kMesaCpu, "CPU"), testing::ElementsAre(test::Names("Intel ... /dev/dri/renderD128")));
    EXPECT_THAT(list(0x8086, "integrated GPU"), testing::IsEmpty());
    put(folder / "dev/nvidia3", "");
    put(folder / "dev/nvidia-modeset", "");
    EXPECT_THAT(list(0x8086, "integrated GPU"),
                testing::ElementsAre(test::Names("NVIDIA ... (/dev/nvidia3)")));
    put(folder / "dev/kfd", "");
    EXPECT_THAT(list(0x10DE, "discrete GPU"), testing::SizeIs(2)) << "AMD and Intel";
}

TEST_F(MissingDrivers, OfWindowsAndOfNodesThatAContainerLacks) {
    add_render_node("renderD128", "0x1002\n");
    add_render_node("renderD129", "0x1af4\n");  // a virtual card
    std::filesystem::remove(folder / "dev/dri/renderD128");
    EXPECT_THAT(list(kMesaCpu, "CPU"), testing::IsEmpty());
    put(folder / "dev/dxg", "");
    EXPECT_THAT(list(kMesaCpu, "CPU"), testing::ElementsAre(test::Names("/dev/dxg")));
    EXPECT_THAT(list(0x10DE, "discrete GPU"), testing::IsEmpty());
}

TEST_F(Gpu, UploadsAndDownloadsAreEqual) {
    // the last size exceeds the staging buffer
    for (const std::size_t n : {std::size_t(1), std::size_t(1000), std::size_t(9) << 20}) {
        std::vector<std::uint32_t> values(n);
        std::iota(values.begin(), values.end(), 7u);
        const Array<std::uint32_t> array(device(), std::span<const std::uint32_t>(values), "test");
        EXPECT_EQ(array.download(), values);
    }
}

TEST_F(Gpu, MemoryIsCountedAndReturned) {
    const std::uint64_t before = device().allocated_bytes();
    {
        const Array<float> array(device(), 1 << 20, "test");
        EXPECT_GE(device().allocated_bytes(), before + (4u << 20));
        EXPECT_GE(device().peak_bytes(), before + (4u << 20));
    }
    EXPECT_EQ(device().allocated_bytes(), before);
}

TEST_F(Gpu, GrowingKeepsWhatThereWas) {
    std::vector<std::uint32_t> values(1000);
    std::iota(values.begin(), values.end(), 3u);
    Array<std::uint32_t> array(device(), std::span<const std::uint32_t>(values), "test");
    array.reserve(device(), 5000, "test");
    EXPECT_EQ(array.size(), 5000u);
    EXPECT_EQ(array.download(1000), values);
    const Address<std::uint32_t> address = array.address();
    array.reserve(device(), 10, "test");
    EXPECT_EQ(array.address(), address) << "there is room already";
}

TEST_F(Gpu, MemoryLimitIsKept) {
    // this device is created without the validation layer, which the first device may use
    Device limited({.memory_limit_bytes = 8u << 20});
    Array<float> first(limited, 1 << 20, "the first half");
    EXPECT_THAT(error_message<DeviceError>([&] { first.reserve(limited, 2 << 20, "twice the first half"); }),
                test::Names("twice the first half ... 4.0 MiB ... 8.0 MiB"));
    EXPECT_EQ(first.size(), std::size_t(1) << 20) << "as before";
    first = {};
    EXPECT_NO_THROW(Array<float>(limited, 3 << 19, "what fits now"));
    ::setenv("RELIDAR_MEMORY_LIMIT_MIB", "1", 1);
    Device by_environment(apply_environment());
    ::setenv("RELIDAR_MEMORY_LIMIT_MIB", "much", 1);
    EXPECT_THROW(apply_environment(), UsageError);
    EXPECT_NO_THROW(Device()) << "nobody asked for the environment";
    ::unsetenv("RELIDAR_MEMORY_LIMIT_MIB");
    EXPECT_THROW(Array<float>(by_environment, 1 << 19, "2 MiB"), DeviceError);
}

TEST_F(Gpu, TimesKeepTheLastLaunchesAndTheTotalsOfAll) {
    KernelTimes times, later;
    for (int i = 0; i < KernelTimes::kMaxTimes + 3; ++i) times.add_launch_time("fill", i < 3 ? 5.0 : 1.0);
    EXPECT_EQ(times.milliseconds.at("fill"), std::vector<double>(KernelTimes::kMaxTimes, 1.0));
    EXPECT_EQ(times.totals.at("fill").launches, KernelTimes::kMaxTimes + 3);
    EXPECT_EQ(times.totals.at("fill").ms, KernelTimes::kMaxTimes + 15);
    later.add_launch_time("fill", 2.0);
    later.add_launch_time("copy", 3.0);
    times.add_times(later);
    EXPECT_EQ(times.milliseconds.at("fill").size(), std::size_t(KernelTimes::kMaxTimes));
    EXPECT_EQ(times.milliseconds.at("fill").back(), 2.0);
    EXPECT_EQ(times.totals.at("fill").launches, KernelTimes::kMaxTimes + 4);
    EXPECT_EQ(times.totals.at("copy").ms, 3.0);
}

TEST_F(Gpu, CopiesAreOrderedAndKeepWhatLiesBehind) {
    const std::vector<std::uint32_t> zeros(1000, 0u);
    const Array<std::uint32_t> from(device(), 1000, "test"),
        to(device(), std::span<const std::uint32_t>(zeros), "test");
    Stream stream(device());
    stream.fill(from, 7u);
    stream.copy(from.buffer(), to.buffer(), 4 * 999);
    stream.fill(from, 8u);
    stream.submit_and_wait();
    std::vector<std::uint32_t> expected(1000, 7u);
    expected.back() = 0u;
    EXPECT_EQ(to.download(), expected);
    EXPECT_EQ(from.download(), std::vector<std::uint32_t>(1000, 8u));
}

TEST_F(Gpu, ImpossibleRequestsSayWhatWasAsked) {
    EXPECT_THAT(error_message<DeviceError>(
                    [&] { Array<float>(device(), std::size_t(1) << 44, "a test of the impossible"); }),
                test::Names("a test of the impossible"));
    EXPECT_THROW(Device({.index = 1000}), DeviceError);
}

TEST_F(Gpu, ExtensionsOfRayQueryAreEnabledForRayQueryAlone) {
    const auto has_ray_tracing = [](const Device& d) {
        const auto& enabled = d.impl().extensions;
        return std::any_of(enabled.begin(), enabled.end(), [](const char* name) {
            const std::string text = name;
            return text.find("acceleration_structure") != std::string::npos ||
                   text.find("ray_query") != std::string::npos ||
                   text.find("deferred_host") != std::string::npos;
        });
    };
    if (device().info().software) {
        const Device software({.index = device().info().index, .traversal = RayTracingBackend::software});
        EXPECT_EQ(software.backend(), RayTracingBackend::software);
        EXPECT_FALSE(has_ray_tracing(software));
    }
    if (device().info().ray_query) {
        const Device ray_query({.index = device().info().index, .traversal = RayTracingBackend::ray_query});
        EXPECT_EQ(ray_query.backend(), RayTracingBackend::ray_query);
        EXPECT_TRUE(has_ray_tracing(ray_query));
    } else {
        EXPECT_THROW(Device({.index = device().info().index, .traversal = RayTracingBackend::ray_query}),
                     DeviceError);
    }
}

TEST_F(Gpu, SubgroupsOfVaryingSizeMustBeControlled) {
    VkPhysicalDeviceSubgroupProperties subgroup{};
    subgroup.supportedStages = VK_SHADER_STAGE_COMPUTE_BIT;
    subgroup.supportedOperations = VK_SUBGROUP_FEATURE_VOTE_BIT | VK_SUBGROUP_FEATURE_BALLOT_BIT |
                                   VK_SUBGROUP_FEATURE_ARITHMETIC_BIT | VK_SUBGROUP_FEATURE_SHUFFLE_BIT;
    VkPhysicalDeviceSubgroupSizeControlProperties sizes{};
    sizes.minSubgroupSize = 8;
    sizes.maxSubgroupSize = 32;
    gpu::OptionalFeatures optional;
    EXPECT_EQ(gpu::missing_for_software(subgroup, sizes, optional),
              "subgroupSizeControl and computeFullSubgroups for subgroups of varying size");
    optional.subgroup_size = true;
    EXPECT_FALSE(gpu::can_fix_subgroup_size(sizes, optional)) << "some lanes may be missing";
    optional.full_subgroups = true;
    EXPECT_EQ(gpu::missing_for_software(subgroup, sizes, optional), "");
    sizes.maxSubgroupSize = 8;
    EXPECT_EQ(gpu::missing_for_software(subgroup, sizes, {}), "") << "one size";
    subgroup.supportedOperations &= ~VkSubgroupFeatureFlags(VK_SUBGROUP_FEATURE_SHUFFLE_BIT);
    EXPECT_EQ(gpu::missing_for_software(subgroup, sizes, {}), "subgroup shuffles in compute");
}

TEST_F(Gpu, NetworksNeedShufflesInKnownSubgroups) {
    VkPhysicalDeviceSubgroupProperties subgroup{};
    VkPhysicalDeviceSubgroupSizeControlProperties sizes{};
    sizes.minSubgroupSize = sizes.maxSubgroupSize = 8;
    EXPECT_EQ(gpu::missing_for_networks(subgroup, sizes, {}), "subgroup shuffles in compute");
    subgroup.supportedOperations = VK_SUBGROUP_FEATURE_SHUFFLE_BIT;
    EXPECT_EQ(gpu::missing_for_networks(subgroup, sizes, {}), "");
    sizes.maxSubgroupSize = 32;
    EXPECT_NE(gpu::missing_for_networks(subgroup, sizes, {}), "") << "lanes of one size are not known";
}

TEST_F(Gpu, BestTraversalFollowsWhatADeviceHas) {
    DeviceInfo d;
    d.type = "discrete GPU";
    EXPECT_EQ(best_backend(d), RayTracingBackend::automatic) << "neither";
    d.software = true;
    EXPECT_EQ(best_backend(d), RayTracingBackend::software);
    d.ray_query = true;
    EXPECT_EQ(best_backend(d), RayTracingBackend::ray_query);
    d.type = "CPU";
    EXPECT_EQ(best_backend(d), RayTracingBackend::software);
    d.software = false;
    EXPECT_EQ(best_backend(d), RayTracingBackend::ray_query);
}

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

TEST_F(GpuMemory, IsSharedOnRequest) {
    const Array<std::uint32_t> unshared(device(), 4, "not shared");
    EXPECT_EQ(unshared.buffer().address_for_others().pointer, nullptr);
    Device shared({.index = device().info().index, .share_memory = true});
    auto array =
        std::make_unique<Array<std::uint32_t>>(shared, std::vector<std::uint32_t>{1, 2, 3, 4}, "shared");
    const MemoryAddress address = array->buffer().address_for_others();
    if (shared.info().type != "CPU") GTEST_SKIP() << "only the host can read the address here";
    ASSERT_EQ(address.interface, MemoryAddress::Interface::host);
    auto* values = reinterpret_cast<std::uint32_t*>(address.pointer);
    EXPECT_THAT(std::vector(values, values + 4), testing::ElementsAre(1, 2, 3, 4));
    values[2] = 7;
    EXPECT_THAT(array->download(), testing::ElementsAre(1, 2, 7, 4));
    const Buffer handle = array->buffer().share();
    array.reset();
    // Would get the memory of the destroyed array if the handle did not keep it.
    const Array<std::uint32_t> other(shared, std::vector<std::uint32_t>(4), "other");
    EXPECT_EQ(values[2], 7u);
}

TEST_F(GpuMemory, CopiesAreCounted) {
    Device fresh({.index = device().info().index});
    Array<std::uint32_t> array(fresh, std::vector<std::uint32_t>(100), "counted");
    array.download(30);
    Stream stream(fresh);
    ReadbackBuffer readback(fresh, 8, "counted");
    readback.record_copy(stream, array.buffer(), 8);
    const TransferCounts counts = fresh.transfers();
    EXPECT_EQ(counts.uploads, 1u);
    EXPECT_EQ(counts.upload_bytes, 400u);
    EXPECT_EQ(counts.downloads, 2u);
    EXPECT_EQ(counts.download_bytes, 128u);
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
    const std::string parts = "61.0 MiB ... a large test array ... 60.0 MiB";
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
