// SPDX-License-Identifier: Apache-2.0
#include <numeric>

#include "../base/codecs/temporary_folder.hpp"
#include "gpu/context.hpp"
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

TEST_F(Gpu, FillsAreOrderedAndManySubmissionsOverlap) {
    Array<std::uint32_t> array(device(), 100, "test");
    Stream stream(device(), true);
    for (std::uint32_t i = 0; i < 20; ++i) {
        stream.fill(array, i);
        stream.submit_commands();
    }
    stream.submit_and_wait();
    EXPECT_EQ(array.download(), std::vector<std::uint32_t>(100, 19u));
    EXPECT_EQ(stream.times().milliseconds.at("fill").size(), device().info().timestamps ? 20u : 0u);
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

}  // namespace
}  // namespace relidar
