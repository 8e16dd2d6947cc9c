// SPDX-License-Identifier: Apache-2.0
#include <fstream>
#include <numeric>

#include <stdlib.h>

#include <relidar/base/error.hpp>
#include "gpu/copy_rate.hpp"
#include "gpu/prefix_sum.hpp"
#include "gpu/stream.hpp"
#include "support/device.hpp"
#include "support/names.hpp"
#include "support/work_in_flight.hpp"

namespace relidar {
namespace {

using Words = std::vector<std::uint32_t>;

class StreamTest : public test::DeviceTest {};

/// Launch i copies word i with gpu/scan_write, as the sum of this single word.
TEST_F(StreamTest, ThousandsOfLaunchesAndAMegabyteInOneSubmission) {
    // more submissions than slots, so that memory is reused
    constexpr std::uint32_t kWords = 1 << 18, kLaunches = 5000, kSubmissions = 5;
    const Array<std::uint32_t, shared::ScanCounts> words(device(), kWords, "words");
    const Array<std::uint32_t, shared::ScanPrefix> prefix(device(), 1, "prefix");
    std::vector<Array<std::uint32_t, shared::ScanTotal>> sums;
    PrefixSum prefix_sum(device());
    Stream stream(device(), true);
    for (std::uint32_t s = 0; s < kSubmissions; ++s) {
        Words values(kWords);
        std::iota(values.begin(), values.end(), 1000u * s);
        stream.impl().record_write(words.buffer(), values.data(), 4 * kWords);
        sums.emplace_back(device(), kLaunches, "sums");
        for (std::uint32_t i = 0; i < kLaunches; ++i)
            prefix_sum.run(stream, {words.address(), i, 1}, prefix.address(), 1, sums.back().address(i));
        stream.submit_commands();
    }
    stream.submit_and_wait();
    for (std::uint32_t s = 0; s < kSubmissions; ++s) {
        Words expected(kLaunches);
        std::iota(expected.begin(), expected.end(), 1000u * s);
        EXPECT_EQ(sums[s].download(), expected) << "submission " << s;
    }
    EXPECT_EQ(words.download().back(), 1000u * (kSubmissions - 1) + kWords - 1);
}

/// An array that is not set must be read as zeros, not from address 0.
TEST_F(StreamTest, ArraysThatAreLeftOutAreZeros) {
    constexpr std::uint32_t n = 64;
    const std::vector<glm::vec4> ones(n, glm::vec4(1.0f));
    const Array<glm::vec4, shared::CopyTarget> to(device(), std::span<const glm::vec4>(ones), "copy");
    const Kernel<shared::CopyParams> copy(device(), "gpu/copy");
    Stream stream(device());
    run(stream, copy, n, {.from = {}, .to = to.address(), .n = n});
    stream.submit_and_wait();
    EXPECT_EQ(to.download(), std::vector<glm::vec4>(n, glm::vec4(0.0f)));
}

TEST_F(StreamTest, CopyThatIsMeasured) {
    constexpr std::uint32_t kCopied = 1000, kAll = 1003;
    std::vector<glm::vec4> values(kAll);
    for (std::uint32_t i = 0; i < kAll; ++i)
        values[i] = glm::vec4(float(i)) + glm::vec4(0.0f, 0.25f, 0.5f, 0.75f);
    const Array<glm::vec4, shared::CopySource> from(device(), values, "source");
    const Array<glm::vec4, shared::CopyTarget> to(device(), std::vector<glm::vec4>(kAll, glm::vec4(-1.0f)),
                                                  "target");
    const Kernel<shared::CopyParams> copy(device(), "gpu/copy",
                                          {{SpecialisationConstantId::WORKGROUP_SIZE, 256u}});
    Stream stream(device());
    run(stream, copy, kCopied, {.from = from.address(), .to = to.address(), .n = kCopied});
    stream.submit_and_wait();
    for (std::uint32_t i = kCopied; i < kAll; ++i) values[i] = glm::vec4(-1.0f);
    EXPECT_EQ(to.download(), values);
    EXPECT_GT(measure_bandwidth(device()).value_or(0.0),
              1e8);  // all memory is faster than this
}

TEST_F(StreamTest, ReadbacksArriveWithTheirSubmission) {
    const Array<std::uint32_t> array(device(), 100, "test");
    Stream stream(device(), true);
    std::vector<ReadbackBuffer> readbacks;
    for (std::uint32_t i = 0; i < 8; ++i) {
        readbacks.emplace_back(device(), 400, "a test's values");
        EXPECT_FALSE(readbacks.back().is_pending());
        stream.fill(array, i);
        readbacks.back().record_copy(stream, array.buffer(), 396, 4);
        stream.fill(array, 77u);  // after the copy
        EXPECT_TRUE(readbacks.back().is_pending());
        stream.submit_commands();
    }
    for (std::uint32_t i = 8; i-- > 0;) {  // in reverse order
        const auto* values = static_cast<const std::uint32_t*>(readbacks[i].wait_for_bytes(stream));
        EXPECT_EQ(Words(values, values + 99), Words(99, i));
        EXPECT_FALSE(readbacks[i].is_pending());
    }
}

TEST_F(StreamTest, ReadbacksAreUsedAgain) {
    const Array<std::uint32_t> array(device(), 1, "test");
    Stream stream(device());
    ReadbackBuffer readback(device(), 4, "a test's value");
    for (std::uint32_t i = 0; i < 10; ++i) {
        EXPECT_EQ(readback.is_pending(), i > 0);
        if (i > 0) {
            EXPECT_EQ(*static_cast<const std::uint32_t*>(readback.wait_for_bytes(stream)), i - 1);
        }
        stream.fill(array, i);
        readback.record_copy(stream, array.buffer(), 4);
        stream.submit_commands();
    }
}

TEST_F(StreamTest, ReadbacksOutOfOrderAreBugs) {
    const Array<std::uint32_t> array(device(), 10, "test");
    Stream stream(device());
    ReadbackBuffer readback(device(), 20, "a test's values");
    EXPECT_THROW(readback.wait_for_bytes(stream), Error) << "nothing recorded";
    EXPECT_THROW(readback.record_copy(stream, array.buffer(), 24), Error) << "more than it can hold";
    EXPECT_THROW(readback.record_copy(stream, array.buffer(), 20, 24), Error) << "more than there is";
    readback.record_copy(stream, array.buffer(), 20, 20);
    EXPECT_THROW(readback.wait_for_bytes(stream), Error) << "not submitted";
    stream.submit_commands();
    EXPECT_NE(readback.wait_for_bytes(stream), nullptr);
}

/// Checks barriers with the synchronization validation of the Vulkan layer.
class StreamHazards : public StreamTest {
protected:
    std::optional<Device> hazards;  ///< device with synchronization validation

    void SetUp() override {
        StreamTest::SetUp();
        if (IsSkipped() || HasFatalFailure()) return;
        if (const char* validation_variable = ::getenv("RELIDAR_VALIDATION");
            !validation_variable || std::string(validation_variable) != "1")
            GTEST_SKIP() << "no validation layer asked for";
        ::setenv("VK_LAYER_ENABLES", "VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT", 1);
        hazards.emplace(DeviceOptions{.index = device().info().index, .validation = true});
        ::unsetenv("VK_LAYER_ENABLES");
    }
};

TEST_F(StreamHazards, ConcurrentScopesHaveOneBarrierAtTheirEnd) {
    Device& watched = *hazards;
    const Array<std::uint32_t> a(watched, 100, "a"), b(watched, 100, "b"), c(watched, 100, "c");
    Stream stream(watched, true);
    {
        const ConcurrentLaunchScope scope(stream);
        stream.fill(a, 1u);
        {
            const ConcurrentLaunchScope inner(stream);
            stream.fill(b, 2u);
        }
        stream.fill(c, 3u);
    }
    stream.copy(a.buffer(), b.buffer(), 400);
    stream.fill(a, 4u);
    stream.submit_and_wait();
    EXPECT_EQ(validation_count(watched), 0u) << "every launch but those of the scope waits";
    EXPECT_EQ(b.download(), Words(100, 1u));
    EXPECT_EQ(c.download(), Words(100, 3u));
    EXPECT_EQ(validation_count(watched), 0u);
    EXPECT_EQ(stream.times().milliseconds.at("fill").size(), device().info().timestamps ? 4u : 0u);
    {
        const ConcurrentLaunchScope scope(stream);
        stream.fill(a, 5u);
        stream.fill(a, 6u);  // deliberate hazard: the same array twice
        EXPECT_THROW(stream.submit_commands(), Error) << "in an open scope";
    }
    stream.submit_and_wait();
    EXPECT_GT(validation_count(watched), 0u) << "no barrier inside the scope";
}

TEST_F(StreamHazards, LanesHaveABarrierAfterEachStep) {
    Device& watched = *hazards;
    std::vector<Array<std::uint32_t>> arrays;
    for (int i = 0; i < 6; ++i) arrays.emplace_back(watched, 100, "test");
    const auto copy = [&](Stream& stream, std::size_t from, std::size_t to) {
        stream.copy(arrays[from].buffer(), arrays[to].buffer(), 400);
    };
    Stream stream(watched, true);
    {
        ConcurrentSequenceScope lanes(stream, 2);
        stream.fill(arrays[0], 1u);
        lanes.select_lane(1);
        {
            const ConcurrentLaunchScope scope(stream);  // a single step
            stream.fill(arrays[3], 2u);
            stream.fill(arrays[4], 3u);
        }
        copy(stream, 3, 5);
        lanes.select_lane(0);
        copy(stream, 0, 1);
        copy(stream, 1, 2);
        lanes.select_lane(1);
        stream.impl().record_write(arrays[3].buffer(), Words(50, 7u).data(), 200);
    }
    copy(stream, 5, 0);
    stream.submit_and_wait();
    EXPECT_EQ(validation_count(watched), 0u);
    for (const auto& [array, value] :
         std::map<std::size_t, std::uint32_t>{{0, 2u}, {1, 1u}, {2, 1u}, {4, 3u}, {5, 2u}})
        EXPECT_EQ(arrays[array].download(), Words(100, value)) << array;
    EXPECT_EQ(arrays[3].download(50), Words(50, 7u));
    if (device().info().timestamps) {
        EXPECT_EQ(stream.times().milliseconds.at("fill").size(), 1u) << "three side by side";
        EXPECT_EQ(stream.times().milliseconds.at("copy").size(), 3u);
    }
    {
        ConcurrentSequenceScope lanes(stream, 2);
        stream.fill(arrays[0], 5u);
        lanes.select_lane(1);
        stream.fill(arrays[0], 6u);  // deliberate hazard: an array that the other lane writes
    }
    stream.submit_and_wait();
    EXPECT_GT(validation_count(watched), 0u) << "no barrier between lanes";
}

TEST_F(StreamTest, LanesMayBeSubmittedBeforeTheirEnd) {
    const Array<std::uint32_t> a(device(), 100, "a"), b(device(), 100, "b");
    Stream stream(device());
    ReadbackBuffer first(device(), 400, "a"), second(device(), 400, "b");
    {
        ConcurrentSequenceScope lanes(stream, 3);
        lanes.select_lane(2);
        stream.fill(a, 1u);
        first.record_copy(stream, a.buffer(), 400);
        stream.submit_and_wait();
        EXPECT_EQ(a.download(), Words(100, 1u));
        EXPECT_EQ(static_cast<const std::uint32_t*>(first.wait_for_bytes(stream))[99], 1u);
        stream.fill(b, 2u);
        second.record_copy(stream, b.buffer(), 400);
        EXPECT_THROW(lanes.select_lane(3), Error);
        EXPECT_THROW(ConcurrentSequenceScope(stream, 2), Error) << "within others";
        const ConcurrentLaunchScope scope(stream);
        EXPECT_THROW(lanes.select_lane(0), Error) << "in an open scope";
    }
    stream.submit_commands();
    EXPECT_EQ(static_cast<const std::uint32_t*>(second.wait_for_bytes(stream))[99], 2u);
    EXPECT_THROW(ConcurrentSequenceScope(stream, 0), Error);
}

/// Workgroups are expected to take 1 ms, so a launch is cut into 10 pieces of 0.1 s.
class CutLaunches : public StreamTest {
protected:
    static constexpr std::uint32_t kGroups = 1000, kThreads = 32, kValues = kGroups * kThreads - 5;
    std::vector<glm::vec4> values = std::vector<glm::vec4>(kValues);
    std::optional<Array<glm::vec4, shared::CopySource>> from;
    std::optional<Kernel<shared::CopyParams>> copy;
    double piece_s_before = 0.0;

    void SetUp() override {
        StreamTest::SetUp();
        if (IsSkipped() || HasFatalFailure()) return;
        for (std::uint32_t i = 0; i < kValues; ++i) values[i] = glm::vec4(float(i));
        from.emplace(device(), values, "source");
        copy.emplace(
            device(), KernelName<shared::CopyParams>("gpu/copy"),
            std::vector<SpecialisationConstant>{{SpecialisationConstantId::WORKGROUP_SIZE, kThreads}});
        piece_s_before = std::exchange(limit().piece_s, 0.1);
        limit().speed_of("gpu/copy").add_dispatch(1000, 1.0);
    }
    void TearDown() override {
        if (copy) limit().piece_s = piece_s_before;
        from.reset();
        copy.reset();
        StreamTest::TearDown();
    }
    gpu::LaunchTimeLimit& limit() { return device().impl().launch_limit; }
    Array<glm::vec4, shared::CopyTarget> target() {
        return {device(), std::vector<glm::vec4>(kValues, glm::vec4(-1.0f)), "target"};
    }
    void launch(Stream& stream, const Array<glm::vec4, shared::CopyTarget>& to) {
        run(stream, *copy, kValues, {.from = from->address(), .to = to.address(), .n = kValues});
    }
};

TEST_F(CutLaunches, DoTheSameWork) {
    EXPECT_EQ(limit().speed_of("gpu/copy").workgroups_for(0.1), 100u);
    EXPECT_EQ(limit().speed_of("unknown").workgroups_for(0.1), gpu::KernelSpeed::kUnknownGroups);
    Stream stream(device(), true);
    for (const bool in_lane : {false, true}) {
        const auto to = target();
        if (in_lane) {
            ConcurrentSequenceScope lanes(stream, 1);
            launch(stream, to);
        } else launch(stream, to);
        EXPECT_EQ(stream.impl().slots[stream.impl().current].n_buffers, in_lane ? 1u : 10u);
        stream.submit_and_wait();
        EXPECT_EQ(to.download(), values);
    }
    if (!device().info().timestamps) return;
    EXPECT_EQ(stream.times().totals.at("gpu/copy").launches, 2.0);
    EXPECT_EQ(stream.times().milliseconds.at("gpu/copy").size(), 2u);
}

/// The later pieces are recorded, and the next submission runs them. The arrays must be
/// freed after this submission.
TEST_F(CutLaunches, ArraysOutliveAnException) {
    Stream stream(device());
    const std::uint64_t allocated = device().allocated_bytes();
    const test::WorkInFlight work;
    try {
        const auto to = target();
        launch(stream, to);
        EXPECT_GE(work.n_submissions(), 9) << "the launch is not cut";
        throw std::runtime_error("between two parts");
    } catch (const std::runtime_error&) {}
    EXPECT_EQ(work.n_destroyed(), 0) << "recorded commands use the array";
    stream.submit_and_wait();
    try {
        const auto to = target();
        EXPECT_EQ(work.n_destroyed(), 1) << "the array of before was kept too long";
        launch(stream, to);
        stream.submit_commands();
        throw std::runtime_error("after a submission");
    } catch (const std::runtime_error&) {}
    EXPECT_EQ(work.n_destroyed(), 2);
    EXPECT_EQ(work.n_destroyed_in_flight(), 0);
    EXPECT_EQ(device().allocated_bytes(), allocated);
}

/// A slow launch must count less over time.
TEST(LaunchLimit, ForgetsOldSpeeds) {
    gpu::LaunchTimeLimit limit;
    EXPECT_FALSE(limit.has_limit());
    gpu::KernelSpeed& speed = limit.speed_of("kernel");
    speed.add_dispatch(10, 10.0);
    EXPECT_EQ(speed.workgroups_for(1.0), 1u);
    for (int i = 0; i < 50; ++i) speed.add_dispatch(10, 0.1);
    EXPECT_EQ(speed.workgroups_for(1.0), 100u);
    EXPECT_DOUBLE_EQ(speed.estimate_s(200), 2.0);
}

/// A piece would see a smaller number of workgroups than the launch.
TEST(LaunchLimit, CutsNoKernelThatCountsItsThreads) {
    namespace fs = std::filesystem;
    const fs::path shaders = fs::path(RELIDAR_SOURCE_DIR) / "shaders";
    std::size_t n_counting_kernels = 0;
    for (const auto& entry : fs::recursive_directory_iterator(shaders)) {
        if (entry.path().extension() != ".comp") continue;
        std::ifstream file(entry.path());
        const std::string text((std::istreambuf_iterator<char>(file)), {});
        const bool counts = text.find("thread_count()") != std::string::npos ||
                            text.find("gl_NumWorkGroups") != std::string::npos;
        const std::string name = fs::relative(entry.path(), shaders).replace_extension().generic_string();
        EXPECT_EQ(gpu::can_split(name), !counts) << name;
        n_counting_kernels += counts;
    }
    EXPECT_GE(n_counting_kernels, 4u);
}

struct Named {
    std::vector<std::string> objects, labels;
};
Named* named = nullptr;
VKAPI_ATTR VkResult VKAPI_CALL keep_name(VkDevice, const VkDebugUtilsObjectNameInfoEXT* info) {
    named->objects.push_back(info->pObjectName);
    return VK_SUCCESS;
}
VKAPI_ATTR void VKAPI_CALL keep_label(VkCommandBuffer, const VkDebugUtilsLabelEXT* label) {
    named->labels.push_back(label->pLabelName);
}

TEST_F(StreamTest, ObjectsAndLaunchesHaveNames) {
    Named recorded_names;
    named = &recorded_names;
    const auto set_name = std::exchange(vkSetDebugUtilsObjectNameEXT, keep_name);
    const auto begin_label = std::exchange(vkCmdBeginDebugUtilsLabelEXT, keep_label);
    const auto end_label = std::exchange(vkCmdEndDebugUtilsLabelEXT, nullptr);
    const auto insert_label = std::exchange(vkCmdInsertDebugUtilsLabelEXT, keep_label);
    {
        const Array<glm::vec4, shared::CopySource> from(device(), 64, "vectors to copy");
        const Array<glm::vec4, shared::CopyTarget> to(device(), 64, "copied vectors");
        // no other test uses this workgroup size, so the pipeline is not cached yet
        const Kernel<shared::CopyParams> copy(device(), "gpu/copy",
                                              {{SpecialisationConstantId::WORKGROUP_SIZE, 64u}});
        Stream stream(device());
        stream.fill(from);
        run(stream, copy, 64, {.from = from.address(), .to = to.address(), .n = 64});
        stream.submit_and_wait();
    }
    vkSetDebugUtilsObjectNameEXT = set_name;
    vkCmdBeginDebugUtilsLabelEXT = begin_label;
    vkCmdEndDebugUtilsLabelEXT = end_label;
    vkCmdInsertDebugUtilsLabelEXT = insert_label;
    EXPECT_THAT(recorded_names.labels,
                testing::ElementsAre("fill", "gpu/copy", "vr-marker,frame_end,type,application"));
    for (const char* name :
         {"vectors to copy", "copied vectors", "gpu/copy", "commands of a stream", "submissions of a stream"})
        EXPECT_THAT(recorded_names.objects, testing::Contains(name));
}

VKAPI_ATTR VkResult VKAPI_CALL allocate_nothing(VkDevice, const VkMemoryAllocateInfo*,
                                                const VkAllocationCallbacks*, VkDeviceMemory*) {
    return VK_ERROR_OUT_OF_DEVICE_MEMORY;
}

/// 100 MiB exceed the shared blocks, so the driver must allocate new memory.
TEST_F(StreamTest, FailedAllocationNamesNeedAndBudget) {
    const auto allocate = std::exchange(vkAllocateMemory, allocate_nothing);
    EXPECT_THAT([&] { Buffer(device(), 100 << 20, "arrays of a test"); },
                testing::ThrowsMessage<DeviceError>(testing::AllOf(
                    test::Names("100.0 MiB ... arrays of a test ... VK_ERROR_OUT_OF_DEVICE_MEMORY"),
                    testing::ContainsRegex("[0-9.]+ MiB, .*[0-9.]+ MiB .* [1-9][0-9.]+ MiB"))));
    vkAllocateMemory = allocate;
}

}  // namespace
}  // namespace relidar
