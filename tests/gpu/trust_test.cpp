// SPDX-License-Identifier: Apache-2.0
// Tests gpu/check_atomics and gpu/check_subgroups with forced faults.
#include <fstream>

#include <relidar/base/error.hpp>

#include "gpu/check_device.hpp"
#include "gpu/kernel.hpp"
#include "gpu/trust.hpp"
#include "support/device.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

using testing::ElementsAre, testing::HasSubstr, testing::IsEmpty;

class TrustTest : public test::DeviceTest {
protected:
    void SetUp() override {
        test::DeviceTest::SetUp();
        std::filesystem::remove_all(folder);
        if (IsSkipped() || HasFatalFailure()) return;
        options.index = device().info().index;
        options.traversal = device().backend();
        options.pipeline_cache = folder;
    }
    void TearDown() override {
        gpu::inject_faults("");
        set_open_callbacks({});
        std::filesystem::remove_all(folder);
        test::DeviceTest::TearDown();
    }
    void check_gives(const DeviceTestResults& result) {
        set_open_callbacks({[this, result](const DeviceOptions&) {
                                ++n_checks;
                                return result;
                            },
                            [this](const std::string& text) { notes.push_back(text); }});
    }
    std::filesystem::path file() const {
        for (const auto& entry : std::filesystem::directory_iterator(folder))
            if (entry.path().filename().string().starts_with("check_")) return entry.path();
        return {};
    }

    const std::filesystem::path folder = std::filesystem::temp_directory_path() / "relidar_trust_test";
    DeviceOptions options;
    int n_checks = 0;
    std::vector<std::string> notes;
};

TEST_F(TrustTest, SumsAndSubgroupsOfThisDeviceAreRight) {
    if (device().info().float_atomics) {
        EXPECT_EQ(test_atomic_adds(device(), AtomicAddMethod::float_atomics), 0.0);
    }
    EXPECT_EQ(test_atomic_adds(device(), AtomicAddMethod::compare_and_swap), 0.0);
    EXPECT_EQ(test_subgroups(device()), "");
    EXPECT_THAT(subgroup_sizes(device()), testing::Contains(device().info().subgroup_size));
}

/// Without atomics, some of the 256 additions to each sum must be lost.
TEST_F(TrustTest, ForcedFaultsAreFound) {
    gpu::inject_faults("float_atomics");
    if (device().info().float_atomics) {
        EXPECT_GT(test_atomic_adds(device(), AtomicAddMethod::float_atomics), 0.1);
    }
    EXPECT_EQ(test_atomic_adds(device(), AtomicAddMethod::compare_and_swap), 0.0);
    gpu::inject_faults("float_swaps,subgroups:" + std::to_string(device().info().subgroup_size));
    EXPECT_GT(test_atomic_adds(device(), AtomicAddMethod::compare_and_swap), 0.1);
    EXPECT_THAT(test_subgroups(device()), HasSubstr("subgroupAdd: found"));
    gpu::inject_faults("subgroups:128");
    EXPECT_EQ(test_subgroups(device()), "");
}

TEST_F(TrustTest, DeviceIsCheckedOncePerDriver) {
    check_gives({.ray_query = CheckVerdict::right});
    { const Device first(options), second(options); }
    EXPECT_EQ(n_checks, 1);
    std::ofstream(file(), std::ios::app) << "damaged";
    { const Device third(options); }
    EXPECT_EQ(n_checks, 2);
    std::ifstream in(file());
    std::string text((std::istreambuf_iterator<char>(in)), {});
    const std::size_t driver = text.find(device().info().driver);
    ASSERT_NE(driver, std::string::npos);
    std::ofstream(file()) << text.insert(driver, "older ");
    { const Device fourth(options); }
    EXPECT_EQ(n_checks, 3);
    EXPECT_THAT(notes, IsEmpty());
}

/// A forced fault and a new check function need another check.
TEST_F(TrustTest, DeviceIsCheckedOncePerProcessWithoutAFolder) {
    std::ofstream(folder) << "a file, so that the folder cannot be created";
    for (const std::filesystem::path& cache : {std::filesystem::path(), folder}) {
        options.pipeline_cache = cache;
        n_checks = 0;
        check_gives({.ray_query = CheckVerdict::right});
        { const Device first(options), second(options); }
        EXPECT_EQ(n_checks, 1) << cache;
        gpu::inject_faults("float_swaps");
        { const Device third(options); }
        EXPECT_EQ(n_checks, 2) << cache;
        gpu::inject_faults("");
        { const Device fourth(options); }
        EXPECT_EQ(n_checks, 2) << cache;
    }
}

TEST_F(TrustTest, WrongAtomicsAreReplacedAndReported) {
    if (!device().info().float_atomics) GTEST_SKIP() << "no float atomics";
    check_gives({.float_atomics = false, .ray_query = CheckVerdict::right});
    const Device opened(options);
    EXPECT_FALSE(opened.info().float_atomics);
    EXPECT_EQ(atomic_variant(opened).suffix, "@_swap");
    EXPECT_THAT(notes, ElementsAre(test::Names("gradients")));
}

TEST_F(TrustTest, WrongSumsAllowNoTraining) {
    check_gives({.float_atomics = false, .float_swaps = false, .ray_query = CheckVerdict::right});
    const Device opened(options);
    EXPECT_THROW(atomic_variant(opened), DeviceError);
    EXPECT_THAT(notes.back(), test::Names("train"));
}

TEST_F(TrustTest, AnotherSubgroupSizeIsUsed) {
    const int other = device().info().subgroup_size == 8 ? 16 : 8;
    check_gives({.subgroup_size = other, .ray_query = CheckVerdict::right});
    const Device opened(options);
    EXPECT_EQ(opened.info().subgroup_size, other);
    EXPECT_THAT(notes, ElementsAre(HasSubstr(std::to_string(other) + " lanes")));
}

TEST_F(TrustTest, WrongRayQueriesAreReplaced) {
    if (!device().info().ray_query || !device().info().software) GTEST_SKIP() << "only one traversal";
    check_gives({.ray_query = CheckVerdict::wrong});
    options.traversal = RayTracingBackend::ray_query;
    const Device opened(options);
    EXPECT_EQ(opened.backend(), RayTracingBackend::software);
    EXPECT_THAT(notes, ElementsAre(test::Names("software")));
}

}  // namespace
}  // namespace relidar
