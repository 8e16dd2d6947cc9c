// SPDX-License-Identifier: Apache-2.0
// A file of another driver, or a damaged one, is ignored without an error.
#include <cstring>
#include <iterator>
#include <thread>

#include <stdlib.h>

#include "../base/codecs/temporary_folder.hpp"
#include "gpu/pipeline_cache.hpp"
#include "gpu/prefix_sum.hpp"
#include "gpu/stream.hpp"
#include "scene/shared/scene.h"
#include "support/device.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

/// Recomputes the hash (FNV-1a), which follows the magic number and the size.
std::string update_hash(std::string bytes) {
    std::uint64_t hash = 0xcbf29ce484222325u;
    for (std::size_t i = 24; i < bytes.size(); ++i)
        hash = (hash ^ static_cast<unsigned char>(bytes[i])) * 0x100000001b3u;
    std::memcpy(bytes.data() + 16, &hash, 8);
    return bytes;
}

class PipelinesOfADevice : public test::DeviceTest {};

class PipelineCacheFile : public test::DeviceTest {
protected:
    const ScratchFolder scratch;
    const fs::path folder = scratch.path;

    void SetUp() override {
        DeviceTest::SetUp();
        ASSERT_FALSE(folder.empty());
        for (const char* name : kVariables) before_.emplace_back(name, ::getenv(name) ? ::getenv(name) : "");
        ::setenv("RELIDAR_PIPELINE_CACHE", (folder / "made" / "for it").c_str(), 1);
    }
    void TearDown() override {
        for (const auto& [name, value] : before_)
            value.empty() ? ::unsetenv(name) : ::setenv(name, value.c_str(), 1);
        DeviceTest::TearDown();
    }

    struct Opened {
        fs::path path;
        std::size_t read_bytes;
    };
    static Opened open() {
        Device opened(apply_environment());
        const PrefixSum prefix_sum(opened);
        return {opened.impl().pipeline_cache->path(), opened.impl().pipeline_cache->loaded_bytes()};
    }
    /// A cache without pipelines has only the Vulkan header.
    static bool is_cached_by_driver() {
        Device opened(apply_environment());
        std::size_t n_bytes = 0;
        const Device::Impl& impl = opened.impl();
        vkGetPipelineCacheData(impl.device, impl.pipeline_cache->handle(), &n_bytes, nullptr);
        return n_bytes >= sizeof(VkPipelineCacheHeaderVersionOne);
    }
    static std::size_t files(const fs::path& in) {
        return static_cast<std::size_t>(std::distance(fs::directory_iterator(in), fs::directory_iterator()));
    }

private:
    static constexpr const char* kVariables[] = {"RELIDAR_PIPELINE_CACHE", "XDG_CACHE_HOME", "HOME"};
    std::vector<std::pair<const char*, std::string>> before_;
};

TEST_F(PipelineCacheFile, IsFoundByTheNextDevice) {
    const Opened first = open();
    EXPECT_EQ(first.path.parent_path(), folder / "made" / "for it");
    EXPECT_EQ(first.read_bytes, 0u);
    if (!is_cached_by_driver()) GTEST_SKIP() << "the driver returns no header of a pipeline cache";
    ASSERT_TRUE(fs::is_regular_file(first.path));
    const std::string bytes = read_contents(first.path);
    const auto written = fs::last_write_time(first.path);
    const Opened second = open();
    EXPECT_EQ(second.path, first.path);
    EXPECT_EQ(second.read_bytes + 24, bytes.size());
    EXPECT_EQ(fs::last_write_time(first.path), written) << "nothing new, nothing written";
    EXPECT_EQ(files(first.path.parent_path()), 1u) << "no temporary file stays";
}

TEST_F(PipelineCacheFile, DamagedAndForeignOnesAreIgnoredAndReplaced) {
    if (!is_cached_by_driver()) GTEST_SKIP() << "the driver returns no header of a pipeline cache";
    const fs::path path = open().path;
    const std::string good = read_contents(path);
    const auto changed = [&](std::size_t at) {
        std::string bytes = good;
        bytes[at] = static_cast<char>(bytes[at] ^ 0x40);
        return bytes;
    };
    ASSERT_EQ(update_hash(good), good);
    constexpr std::size_t kVendor = 24 + 8, kUuid = 24 + 16;
    for (const std::string& bad :
         {std::string(), std::string("garbage"), std::string(1000, '\xff'), good.substr(0, 20),
          good.substr(0, good.size() - 1), good + "x", good.substr(24), changed(0), changed(8), changed(16),
          changed(24), update_hash(changed(kVendor)), update_hash(changed(kUuid)),
          changed(good.size() - 1)}) {
        put(path, bad);
        EXPECT_EQ(open().read_bytes, 0u) << bad.size() << " bytes";
        EXPECT_EQ(read_contents(path).size(), good.size()) << "written anew";
    }
}

TEST_F(PipelineCacheFile, UnwritableFoldersAreNoError) {
    put(folder / "a file", "x");
    // permissions would not prevent root from writing
    ::setenv("RELIDAR_PIPELINE_CACHE", (folder / "a file").c_str(), 1);
    EXPECT_EQ(open().read_bytes, 0u);
    EXPECT_EQ(read_contents(folder / "a file"), "x");
    ::setenv("RELIDAR_PIPELINE_CACHE", "/proc/relidar", 1);
    EXPECT_EQ(open().read_bytes, 0u);
}

TEST_F(PipelineCacheFile, TheEnvironmentSaysWhere) {
    ::setenv("RELIDAR_PIPELINE_CACHE", "0", 1);
    EXPECT_TRUE(open().path.empty());
    ::unsetenv("RELIDAR_PIPELINE_CACHE");
    ::setenv("XDG_CACHE_HOME", (folder / "xdg").c_str(), 1);
    ::setenv("HOME", (folder / "home").c_str(), 1);
    EXPECT_EQ(open().path.parent_path(), folder / "xdg" / "relidar");
    ::unsetenv("XDG_CACHE_HOME");
    EXPECT_EQ(open().path.parent_path(), folder / "home" / ".cache" / "relidar");
    EXPECT_EQ(files(folder / "home" / ".cache" / "relidar"), 1u);
    ::unsetenv("HOME");
    EXPECT_TRUE(open().path.empty());
}

/// Kernels with any difference must have separate pipelines.
TEST_F(PipelinesOfADevice, AreMadeOnceForKernelsThatAreAlike) {
    Device opened(apply_environment());
    const auto n_made = [&] { return opened.impl().pipelines.by_key.size(); };
    const std::vector<SpecialisationConstant> of_64{{SpecialisationConstantId::WORKGROUP_SIZE, 64}},
        of_32{{SpecialisationConstantId::WORKGROUP_SIZE, 32}};
    const auto pipeline_of = [&](const std::vector<SpecialisationConstant>& constants,
                                 SubgroupRequirement subgroups = SubgroupRequirement::any) {
        return Kernel<shared::ListTouchedParams>(opened, "scene/list_touched", constants, subgroups)
            .impl()
            .wait_for_pipeline();
    };
    const VkPipeline first = pipeline_of(of_64);
    EXPECT_NE(first, VK_NULL_HANDLE);
    EXPECT_EQ(pipeline_of(of_64), first);
    EXPECT_EQ(n_made(), 1u);
    EXPECT_NE(pipeline_of(of_32), first);
    EXPECT_NE(pipeline_of(of_64, SubgroupRequirement::full), first);
    EXPECT_EQ(n_made(), 3u);
    std::vector<VkPipeline> of_threads(8);
    std::vector<std::thread> threads;
    for (VkPipeline& pipeline : of_threads)
        threads.emplace_back([&] {
            pipeline = pipeline_of({{SpecialisationConstantId::WORKGROUP_SIZE, 128}});
        });
    for (std::thread& thread : threads) thread.join();
    for (const VkPipeline pipeline : of_threads) EXPECT_EQ(pipeline, of_threads[0]);
    EXPECT_EQ(n_made(), 4u);
}

/// A kernel may be destroyed before its pipeline is ready, or may never run.
TEST_F(PipelinesOfADevice, AreBegunWithTheirKernels) {
    Device opened(apply_environment());
    opened.impl().compiles_ahead = true;
    const auto begin = [&](std::uint32_t size) {
        return std::make_unique<Kernel<shared::ListTouchedParams>>(
            opened, KernelName<shared::ListTouchedParams>("scene/list_touched"),
            std::vector<SpecialisationConstant>{{SpecialisationConstantId::WORKGROUP_SIZE, size}});
    };
    const auto used = begin(32), alike = begin(32), unused = begin(64);
    begin(128);
    EXPECT_EQ(opened.impl().pipelines.by_key.size(), 3u);
    EXPECT_NE(used->impl().wait_for_pipeline(), VK_NULL_HANDLE);
    EXPECT_EQ(used->impl().wait_for_pipeline(), alike->impl().wait_for_pipeline());
    for (const auto& [key, made] : opened.impl().pipelines.by_key)
        EXPECT_EQ(made.get().result, VK_SUCCESS) << key;
}

}  // namespace
}  // namespace relidar
