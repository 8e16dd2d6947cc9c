// SPDX-License-Identifier: Apache-2.0
#include "read/lidar_rt_benchmark.hpp"

#include <gtest/gtest.h>

namespace relidar {
namespace {

std::vector<int> test_frames(std::span<const BenchmarkSequence> parts, const char* name,
                             FrameRange frames = {}) {
    return find_drive({.sequence = name, .frames = frames}, parts).test_frames;
}

using Frames = std::vector<int>;

TEST(LidarRtBenchmark, HoldOutWhatIsPublished) {
    EXPECT_EQ(test_frames(kKitti360Benchmark, "ks1"), (Frames{1551, 1564, 1577, 1590}));
    EXPECT_EQ(test_frames(kKitti360Benchmark, "ks4"), (Frames{3366, 3379, 3392, 3405}));
    EXPECT_EQ(test_frames(kKitti360Benchmark, "kd1"), (Frames{2360, 2370, 2380, 2390}));
    EXPECT_EQ(test_frames(kKitti360Benchmark, "kd6"), (Frames{11410, 11420, 11430, 11440}));
    EXPECT_EQ(test_frames(kWaymoBenchmark, "ws1"), (Frames{10, 20, 30, 40}));
    EXPECT_EQ(test_frames(kWaymoBenchmark, "wd1"), (Frames{157, 167, 177, 187}));
    EXPECT_EQ(test_frames(kKitti360Benchmark, "kd1", {2365, 2385}), (Frames{2370, 2380}));
    EXPECT_TRUE(test_frames(kKitti360Benchmark, "0003").empty());
}

TEST(LidarRtBenchmark, HoldOutFourFramesThatAreTheirs) {
    for (const auto& parts : {std::span<const BenchmarkSequence>(kKitti360Benchmark),
                              std::span<const BenchmarkSequence>(kWaymoBenchmark)})
        for (const BenchmarkSequence& part : parts) {
            EXPECT_GT(part.test_first, part.first) << part.name;
            EXPECT_LT(part.test_first + (kBenchmarkTestFrames - 1) * part.test_every, part.last) << part.name;
            EXPECT_EQ(part.test_every, part.name[0] == 'k' && part.name[1] == 's' ? 13 : 10) << part.name;
        }
}

}  // namespace
}  // namespace relidar
