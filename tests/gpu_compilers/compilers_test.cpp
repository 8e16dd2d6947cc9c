// SPDX-License-Identifier: Apache-2.0
// Compiles the kernels of the program for real GPUs without a GPU. Mesa's AMD driver
// compiles for the GPU family in RADV_FORCE_FAMILY and runs nothing (docs/debugging.md).
// ctest has an entry per family. The tests are skipped if the driver is missing.
#include <cstdlib>
#include <set>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/gpu/device.hpp>

#include "gpu/kernel.hpp"
#include "train/compile_pipelines.hpp"

namespace relidar {
namespace {

std::string family() {
    const char* text = std::getenv("RADV_FORCE_FAMILY");
    return text ? text : "";
}

/// Returns the minimum number of waves that a SIMD must hold when it runs the kernel. On
/// GCN (vega) the minimum is 2, because four waves leave 64 registers per lane and
/// tracing kernels need 84 to 128. On RDNA2 (128 registers) and RDNA3 (192) it is 4. The
/// kernel that sums hits with harmonics along the ray may have a wave less, because it
/// holds 64 harmonics in registers.
int find_min_waves(const PipelineStatistics& statistics) {
    const bool gcn = family().starts_with("vega");
    const bool sums_harmonics = statistics.kernel.starts_with("diff/backward/gather@") &&
                                statistics.constants.find("SH_PER_SURFEL=0") != std::string::npos;
    return (gcn ? 2 : 4) - (sums_harmonics ? 1 : 0);
}

/// Returns the number of waves of 64 lanes that a SIMD holds at the same time. On RDNA
/// the driver counts waves of 32 lanes.
double count_waves_of_64(const PipelineStatistics& statistics) {
    const double waves = statistics.values.at("Subgroups per SIMD");
    return family().starts_with("vega") ? waves : waves / 2.0;
}

class GpuCompilers : public ::testing::Test {
protected:
    static std::vector<PipelineStatistics> pipelines_;
    /// suffixes of the kernel variants that the open devices would select
    static std::set<std::string> suffixes_;

    static void compile(RayTracingBackend traversal) {
        Device device({.traversal = traversal, .compile_only = true});
        compile_pipelines(device);
        pipelines_.insert(pipelines_.end(), device.statistics().begin(), device.statistics().end());
        suffixes_.insert(traversal == RayTracingBackend::software ? "@software_bvh" : "@ray_query");
        suffixes_.insert(device.info().float_atomics ? "_atomics" : "_swap");
    }

    static void SetUpTestSuite() {
        std::vector<DeviceInfo> devices;
        try {
            devices = list_devices();
        } catch (const DeviceError&) {
            return;  // no such driver
        }
        if (devices.empty() || devices[0].name.find("Null hardware") == std::string::npos) return;
        compile(RayTracingBackend::software);
        if (devices[0].ray_query) compile(RayTracingBackend::ray_query);
    }

    void SetUp() override {
        if (!pipelines_.empty()) return;
        const char* required = std::getenv("RELIDAR_REQUIRE_GPU");
        if (required && std::string(required) == "1")
            FAIL() << "RELIDAR_REQUIRE_GPU=1, but Mesa's AMD driver (radeon_icd) is not installed";
        GTEST_SKIP() << "Mesa's AMD driver (radeon_icd) is not installed";
    }

    static std::string name(const PipelineStatistics& statistics) {
        return fmt::format("{} [{}], {} threads", statistics.kernel, statistics.constants,
                           statistics.workgroup_size);
    }
};

std::vector<PipelineStatistics> GpuCompilers::pipelines_;
std::set<std::string> GpuCompilers::suffixes_;

TEST_F(GpuCompilers, EveryKernelOfTheBuildIsCompiled) {
    std::set<std::string> compiled;
    for (const PipelineStatistics& p : pipelines_) compiled.insert(p.kernel);
    for (const EmbeddedKernel& kernel : embedded_kernels()) {
        const std::string text(kernel.name);
        // kernels that only tests use
        if (text.starts_with("diff/traversal/collect_hits") || text.find("@brute_force") != std::string::npos)
            continue;
        // kernels of `relidar-dev bench` and `relidar check`
        if (text == "gpu/copy" || text.starts_with("gpu/check_")) continue;
        // kernels that only ray query uses
        if (text == "diff/accel/model_radii" && !suffixes_.count("@ray_query")) continue;
        const bool other =
            (text.find("@software_bvh") != std::string::npos && !suffixes_.count("@software_bvh")) ||
            (text.find("@ray_query") != std::string::npos && !suffixes_.count("@ray_query")) ||
            (text.ends_with("_atomics") && !suffixes_.count("_atomics")) ||
            (text.ends_with("_swap") && !suffixes_.count("_swap"));
        if (other) continue;
        EXPECT_TRUE(compiled.count(text)) << text << " is made by nothing that compile_pipelines() makes";
    }
}

TEST_F(GpuCompilers, EveryPipelineCompiles) {
    for (const PipelineStatistics& p : pipelines_) {
        EXPECT_EQ(p.failure, "") << name(p);
        EXPECT_FALSE(p.values.empty()) << name(p);
    }
}

TEST_F(GpuCompilers, NoKernelSpillsRegisters) {
    for (const PipelineStatistics& p : pipelines_) EXPECT_EQ(p.values.at("Spilled VGPRs"), 0.0) << name(p);
}

TEST_F(GpuCompilers, WavesHideLatency) {
    for (const PipelineStatistics& p : pipelines_)
        EXPECT_GE(count_waves_of_64(p), find_min_waves(p))
            << name(p) << ": " << p.values.at("VGPRs") << " registers";
}

TEST_F(GpuCompilers, SharedMemoryFitsTheSmallestDevices) {
    for (const PipelineStatistics& p : pipelines_) {
        // Subtracts the stack of the ray query (64 B per lane), which Mesa stores in
        // shared memory in addition to the kernel's arrays.
        const double of_query =
            p.kernel.find("@ray_query") != std::string::npos ? 64.0 * p.workgroup_size : 0.0;
        EXPECT_LE(p.values.at("LDS size") - of_query, 32768.0) << name(p);
    }
}

}  // namespace
}  // namespace relidar
