// SPDX-License-Identifier: Apache-2.0
// Writes a little of KITTI-360 and of Waymo Open as they ship, for the test of `relidar tables`:
//   paper_folders DIR
// DIR/KITTI-360 has three frames of kd2 with labels and three of kd1 without; DIR/waymo the segment of ws1 up to its first held-out frame.
#include <cstdio>
#include <exception>
#include <filesystem>

#include "dataset/kitti_360_folder.hpp"
#include "dataset/waymo_segment.hpp"

namespace relidar::test {
namespace {

namespace fs = std::filesystem;

void write_kitti_360(const fs::path& out) {
    constexpr int kLabelled = 4959, kBare = 2359;  // each with the part's first held-out frame in the middle
    const Kitti360Folder dataset("paper_folders", kLabelled);
    for (int i = 0; i < Kitti360Folder::kFrames; ++i) write_text(dataset.scan(kBare + i), read_text(dataset.scan(kLabelled + i)));
    dataset.write_poses({kBare, kBare + 1, kBare + 2, kLabelled, kLabelled + 1, kLabelled + 2});
    fs::copy(dataset.folder, out, fs::copy_options::recursive);
}

void write_waymo(const fs::path& out) {
    constexpr int kRecords = 12;  // ws1 begins at 1 and holds 10 out
    WaymoSegment segment("paper_folders_waymo");
    for (int i = WaymoSegment::kFrames; i < kRecords; ++i) {
        WaymoFrame again = segment.frames[std::size_t(i % WaymoSegment::kFrames)];
        again.timestamp_us = WaymoSegment::kStart_us + i * WaymoSegment::kPeriod_us;
        segment.frames.push_back(again);
    }
    segment.write();
    fs::create_directories(out);
    fs::copy_file(segment.file, out / "segment-1137920_0001_with_camera_labels.tfrecord");
}

}  // namespace
}  // namespace relidar::test

int main(int argc, char** argv) {
    if (argc != 2) return std::fprintf(stderr, "usage: paper_folders DIR\n"), 2;
    try {
        relidar::test::write_kitti_360(std::filesystem::path(argv[1]) / "KITTI-360");
        relidar::test::write_waymo(std::filesystem::path(argv[1]) / "waymo");
    } catch (const std::exception& error) {
        return std::fprintf(stderr, "paper_folders: %s\n", error.what()), 1;
    }
    return 0;
}
