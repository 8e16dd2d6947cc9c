// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/checks.hpp>

#include <cstring>

#include <fmt/format.h>

#include <relidar/read/clouds.hpp>

#include "read/datasets/argoverse2/argoverse2_log.hpp"
#include "read/datasets/kitti/kitti_drive.hpp"
#include "read/datasets/nuscenes/nuscenes_folder.hpp"
#include "read/files/point_writers.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::Names;

void cut(const fs::path& file) { fs::resize_file(file, fs::file_size(file) / 2 + 1); }

std::vector<int> numbers(const Log& log) {
    std::vector<int> numbers;
    for (const Frame& frame : log.frames) numbers.push_back(frame.index);
    numbers.erase(std::unique(numbers.begin(), numbers.end()), numbers.end());
    return numbers;
}

/// Truncates a scan. Reading must fail, or return the remaining scans with a note.
/// @param part part of a dataset with several parts
Log expect_left_out(const fs::path& log, const fs::path& scan, int number, const std::string& part = {}) {
    SCOPED_TRACE(scan.string());
    const DatasetOptions skipping{.sequence = part, .skip_broken = true};
    std::vector<int> expected = numbers(load_log(log.string(), skipping));
    EXPECT_EQ(std::erase(expected, number), 1u);
    cut(scan);
    EXPECT_THROW(load_log(log.string(), {.sequence = part}), DataError);
    Log left = load_log(log.string(), skipping);
    EXPECT_EQ(numbers(left), expected);
    const auto n_notes = std::count_if(left.notes.begin(), left.notes.end(), [&](const std::string& note) {
        return test::find_missing_part(note, "skipped ... " + scan.filename().string()).empty();
    });
    EXPECT_EQ(n_notes, 1) << testing::PrintToString(left.notes);
    for (const Frame& frame : left.frames) EXPECT_GT(frame.scan.count_returns(), 0u) << frame.index;
    return left;
}

TEST(BrokenScans, OfKittiAreAsMissingOnes) {
    const test::KittiDrive drive("broken_scans");
    const Log left = expect_left_out(drive.folder, drive.scan(1), 1);
    fs::remove(drive.scan(1));
    const Log missing = load_log(drive.folder.string(), {});
    ASSERT_EQ(left.frames.size(), missing.frames.size());
    EXPECT_EQ(left.world_from_vehicle.time_s, missing.world_from_vehicle.time_s);
    for (std::size_t i = 0; i < left.frames.size(); ++i) {
        EXPECT_EQ(left.frames[i].time_s, missing.frames[i].time_s);
        EXPECT_TRUE(std::ranges::equal(left.frames[i].scan.range_m, missing.frames[i].scan.range_m)) << i;
        const glm::dvec3 apart = left.world_from_vehicle.pose[i].translation + left.world_offset_m -
                                 missing.world_from_vehicle.pose[i].translation - missing.world_offset_m;
        EXPECT_LT(glm::length(apart), 1e-9) << i;
    }
    EXPECT_NO_THROW(check_log(left));
}

TEST(BrokenScans, OfKittiThatHoldWholePointsAreNoDroppedRays) {
    const test::KittiDrive drive("cut_scans");
    const std::string original = test::read_text(drive.scan(1));
    const std::size_t n = original.size() / 16;
    const auto put = [&](const std::string& bytes) { test::write_text(drive.scan(1), bytes); };
    const auto expect_left = [&](const std::string& reason) {
        const Log left = load_log(drive.folder.string(), {});
        EXPECT_EQ(numbers(left), (std::vector<int>{0, 2})) << reason;
        EXPECT_THAT(left.notes, testing::Contains(Names("0000000001.bin ... " + reason)));
    };
    put(original.substr(0, 16 * (n / 3)));
    expect_left(fmt::format("{} points", n / 3));
    // About eight of 64 rings, which have different numbers of returns.
    put(original.substr(0, 16 * (n - n / 8)));
    expect_left("rings");
    put(std::string(original.size(), '\0'));
    expect_left("0 points");
    for (int frame = 0; frame < 3; ++frame)
        test::write_text(drive.scan(frame), std::string(original.size(), '\0'));
    drive.expect_error("3 scans");
    for (int frame = 0; frame < 3; ++frame) test::write_text(drive.scan(frame), original);
    const auto early = testing::Contains(Names("0000000001.bin ... rings ... azimuth"));
    // The cut is in one of the last two rings. Every tenth point is missing.
    for (const int remaining_deg : {120, 270}) {
        const auto n_missing = std::size_t(0.9 * 701 * (remaining_deg == 120 ? 240 : 360 + 90) / 360.0);
        put(original.substr(0, 16 * (n - n_missing)));
        EXPECT_THAT(load_log(drive.folder.string(), {}).notes, early) << remaining_deg;
        expect_left("rings ... azimuth");
    }
    put(original);
    EXPECT_THAT(drive.load().notes, testing::Not(early));
}

void set_intensities(const test::KittiDrive& drive, float intensity) {
    for (int frame = 0; frame < 3; ++frame) {
        std::string bytes = test::read_text(drive.scan(frame));
        for (std::size_t at = 12; at < bytes.size(); at += 16)
            std::memcpy(bytes.data() + at, &intensity, sizeof intensity);
        test::write_text(drive.scan(frame), bytes);
    }
}

TEST(BrokenScans, OfKittiMayCountIntensitiesTo255) {
    const test::KittiDrive drive("intensities");
    set_intensities(drive, 51.0f);
    const Log log = load_log(drive.folder.string(), {});
    const Scan& scan = log.frames[0].scan;
    for (std::size_t i = 0; i < scan.range_m.size(); ++i)
        if (scan.range_m[i] > 0.0f) {
            ASSERT_FLOAT_EQ(scan.intensity[i], 0.2f);
        }
    EXPECT_THAT(log.notes, testing::Contains(Names("51 ... 255")));
    for (const float wrong : {1.5f, 256.0f, -1.0f}) {
        set_intensities(drive, wrong);
        drive.expect_error("0 ... 1 ... 255");
    }
    set_intensities(drive, 0.0f);
    EXPECT_THAT(load_log(drive.folder.string(), {}).notes, testing::Contains(Names("intensities")));
}

TEST(BrokenScans, OfNuscenesAndArgoverse) {
    const test::NuscenesFolder scene("broken_sweeps");
    expect_left_out(scene.folder, scene.sweep(4), 4, "scene-0103");
    const test::Argoverse2Log log("broken_sweeps");
    for (const int sweep : {0, 1}) {  // the first sweep determines which lasers belong to which LiDAR
        const fs::path file = log.folder / "sensors/lidar" /
                              (std::to_string(test::Argoverse2Log::sweep_ns(sweep)) + ".feather");
        expect_left_out(log.folder, file, sweep);
    }
}

/// Folder with five scans of a cylinder as PCD, without sequence.json.
class BareFolder : public testing::Test {
protected:
    void SetUp() override {
        folder = fs::path(testing::TempDir()) / "relidar_bare_folder";
        fs::remove_all(folder);
        const std::string cylinder = test::make_pcd_binary(test::make_cylinder(90));
        for (int i = 0; i < 5; ++i) test::write_text(folder / scan(i), cylinder);
    }
    static std::string scan(int index) { return std::to_string(index) + ".pcd"; }
    fs::path folder;
};

TEST_F(BareFolder, SaysTheLineThatItLacksAndThatLineDoes) {
    const std::string said = test::find_load_error(folder.string());
    EXPECT_THAT(said, Names("5 scans ... sequence.json"));
    const std::size_t begin = said.find('{'), end = said.rfind('}');
    ASSERT_NE(end, std::string::npos) << said;
    test::write_text(folder / "sequence.json", said.substr(begin, end - begin + 1));
    // The intensities of the scans are 51 of 255.
    const std::string head = test::read_text(folder / "sequence.json");
    test::write_text(folder / "sequence.json", head.substr(0, head.size() - 1) +
                                                   R"(, "intensity_max": 255, "point_times": "absolute"})");
    EXPECT_EQ(load_log(folder.string(), {.poses_file = kNoPoses}).frames.size(), 5u);
}

TEST_F(BareFolder, LeavesBrokenScansOut) {
    test::write_text(folder / "sequence.json",
                     R"({"format": "relidar log", "version": 1, "rate_hz": 10, "intensity_max": 255,
        "point_times": "absolute", "lidars": [{"name": "top", "scans": "."}]})");
    std::string poses;
    for (int i = 0; i < 5; ++i) poses += "1 0 0 0 0 1 0 0 0 0 1 0\n";
    test::write_text(folder / "poses.txt", poses);
    expect_left_out(folder, folder / scan(2), 2);
    cut(folder / scan(0));  // the first scans determine the beams
    EXPECT_EQ(numbers(load_log(folder.string(), {.skip_broken = true})), (std::vector<int>{1, 3, 4}));
    for (const int i : {1, 3, 4}) cut(folder / scan(i));
    EXPECT_THAT(test::find_load_error(folder.string(), {.skip_broken = true}), Names("5 scans"));
}

}  // namespace
}  // namespace relidar
