// SPDX-License-Identifier: Apache-2.0
// Tests the parts of the LiDAR-RT benchmark by their names in the paper. Checks which
// frames belong to a part, and which frames are held out.
#include "log/clouds/lidar_rt_benchmark.hpp"

#include <gtest/gtest.h>

namespace relidar {
namespace {

RequestedDriveFrames kitti(const char* name, FrameRange frames = {}) {
    DatasetOptions options;
    options.sequence = name;
    options.frames = frames;
    return find_requested_drive_and_frames(options, kKitti360Benchmark);
}

RequestedDriveFrames waymo(const char* name) {
    DatasetOptions options;
    options.sequence = name;
    return find_requested_drive_and_frames(options, kWaymoBenchmark);
}

using Frames = std::vector<int>;

TEST(LidarRtBenchmark, HoldOutWhatIsPublished) {
    EXPECT_EQ(kitti("ks1").test_frames, (Frames{1551, 1564, 1577, 1590}));
    EXPECT_EQ(kitti("ks4").test_frames, (Frames{3366, 3379, 3392, 3405}));
    EXPECT_EQ(kitti("kd1").test_frames, (Frames{2360, 2370, 2380, 2390}));
    EXPECT_EQ(kitti("kd6").test_frames, (Frames{11410, 11420, 11430, 11440}));
    EXPECT_EQ(waymo("ws1").test_frames, (Frames{10, 20, 30, 40}));
    EXPECT_EQ(waymo("wd1").test_frames, (Frames{157, 167, 177, 187}));
    EXPECT_EQ(kitti("kd1", {2365, 2385}).test_frames, (Frames{2370, 2380})) << "of what is read";
    EXPECT_TRUE(kitti("0003").test_frames.empty());
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

TEST(LidarRtBenchmark, AreAllNamed) {
    std::string names;
    for (const auto& parts : {std::span<const BenchmarkSequence>(kKitti360Benchmark),
                              std::span<const BenchmarkSequence>(kWaymoBenchmark)})
        for (const BenchmarkSequence& part : parts) {
            const std::string name = part.name;
            names += name + " ";
            int n_frames = 50;
            if (name == "ks4") n_frames = 63;
            else if (name.starts_with("ks")) n_frames = 64;
            EXPECT_EQ(part.last - part.first + 1, n_frames) << name;
        }
    EXPECT_EQ(names, "ks1 ks2 ks3 ks4 kd1 kd2 kd3 kd4 kd5 kd6 ws1 ws2 ws3 ws4 wd1 wd2 wd3 wd4 ");
    EXPECT_EQ(kBenchmarkTestFrames, 4);
}

}  // namespace
}  // namespace relidar
