// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include <cstring>

#include "read/datasets/kitti/kitti_drive.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::KittiDrive;
using test::read_text;
using test::write_text;

TEST(KittiErrors, MissingFoldersAndFiles) {
    const KittiDrive drive("missing");
    EXPECT_THROW(load_log("/nowhere/drive", {}), DataError);
    EXPECT_THROW(load_log("kitti_raw:/nowhere/drive", {}), DataError);
    fs::remove(drive.file("oxts/data/0000000001.txt"));
    drive.expect_error("oxts/data/0000000001.txt");
    fs::remove_all(drive.file("oxts"));
    drive.expect_error("oxts/data ... OXTS ... dataset.poses=FILE ... dataset.poses=none");
    write_text(drive.file("oxts/data/nan.txt"), "");  // belongs to no frame
    drive.expect_error("oxts/data ... OXTS");
    fs::remove(drive.file("velodyne_points/timestamps_end.txt"));
    drive.expect_error("timestamps_end.txt");
    fs::remove_all(drive.file("velodyne_points/data"));
    drive.expect_error("velodyne_points/data ... KITTI");
    fs::create_directories(drive.file("velodyne_points/data"));
    drive.expect_error("velodyne_points/data ... scans");
}

TEST(KittiErrors, MissingCalibration) {
    const KittiDrive drive("uncalibrated");
    fs::remove(drive.calibration());
    drive.expect_error("calib_imu_to_velo.txt ... 2011_12_31_calib ... dataset.poses");
}

TEST(KittiErrors, NumbersOfScans) {
    const KittiDrive drive("numbers");
    write_text(drive.file("velodyne_points/data/0099999999.bin"), "");
    drive.expect_error("timestamps.txt ... 3 ... frame 99999999 ... line 100000000");
    drive.expect_error("99999996 ... 99999999 ... (3, 4, 5, 6, 7, ...)", {.allow_missing_scans = false});
}

TEST(KittiErrors, FoldersThatAreNoDrive) {
    const KittiDrive drive("strangers");
    const auto expect = [](const fs::path& folder, const std::string& parts) {
        EXPECT_THAT(test::find_load_error(folder.string()), test::Names(parts));
    };
    expect(drive.folder.parent_path(), "2011_12_31 ... 1 dataset ... 2011_12_31_drive_0001_sync");
    expect(drive.file("velodyne_points"), "inside ... 2011_12_31_drive_0001_sync");
    expect(drive.file("oxts/data"), "inside");
    const fs::path odometry = drive.folder.parent_path().parent_path() / "dataset/sequences/00";
    write_text(odometry / "velodyne/000000.bin", "");
    write_text(odometry / "times.txt", "0\n");
    expect(odometry, "sequences/00 ... KITTI ... motion-compensated ... KITTI");
    expect(odometry.parent_path().parent_path(), "KITTI odometry");
    for (int frame = 0; frame < 3; ++frame)
        fs::rename(drive.scan(frame), drive.scan(frame).replace_extension("txt"));
    drive.expect_error("text ... _extract ... _sync");
}

TEST(KittiErrors, PosesOutOfThisWorld) {
    const KittiDrive drive("far");
    const std::string good = "1 0 0 0 0 1 0 0 0 0 1 0\n";
    const DatasetOptions options{.poses_file = drive.file("poses.txt")};
    write_text(options.poses_file, good + good + "1 0 0 2e6 0 1 0 0 0 0 1 0\n");
    drive.expect_error("pose 2 ... (2000000, 0, 0)", options);
    const fs::path oxts = drive.file("oxts/data/0000000002.txt");
    write_text(oxts, read_text(oxts).replace(read_text(oxts).find("100.5"), 5, "1e308"));
    drive.expect_error("pose 2 ... 1e+308");
}

TEST(KittiErrors, ScanErrorCollector) {
    const KittiDrive drive("scans");
    const std::string original = read_text(drive.scan(1));
    const auto expect = [&](const std::string& bytes, const std::string& parts) {
        drive.expect_error_with(drive.scan(1), bytes, parts);
    };
    const auto with = [&](std::size_t point, std::size_t field, float value) {
        std::string bytes = original;
        std::memcpy(bytes.data() + 16 * point + 4 * field, &value, 4);
        return bytes;
    };
    expect(original.substr(0, 100), "0000000001.bin ... 100 ... 6 ... 16 ... 4");
    expect("", "0000000001.bin ... empty");
    expect(with(5, 3, INFINITY), "point 5 ... intensity inf");
    expect(with(8, 0, 2e4f), "point 8 ... 10000 m");
    for (int frame = 0; frame < 3; ++frame) write_text(drive.scan(frame), original.substr(0, 16 * 3000));
    drive.expect_error("velodyne_points/data:  ... rings ... 64");
}

std::string make_even_scan(double step_rad, int n_a_ring) {
    std::string bytes;
    for (int ring = 0; ring < 64; ++ring)
        for (int i = 0; i < n_a_ring; ++i) {
            // The last three points of a ring are near the end of the turn, so that the
            // azimuth wraps between rings.
            const double azimuth = i < n_a_ring - 3 ? i * step_rad : 2.0 * kPi - (n_a_ring - i) * 1e-3;
            const double elevation = (2.0 - 0.42 * ring) * kPi / 180.0;
            const double rho = 12.0 + 8.0 * std::sin(0.01 * i);
            const glm::vec4 point(rho * std::cos(azimuth), rho * std::sin(azimuth), rho * std::tan(elevation),
                                  0.5);
            bytes.append(reinterpret_cast<const char*>(&point), sizeof point);
        }
    return bytes;
}

TEST(KittiErrors, AzimuthStepsOfNoSensor) {
    const KittiDrive drive("steps");
    for (int frame = 0; frame < 3; ++frame) write_text(drive.scan(frame), make_even_scan(2e-5, 1000));
    drive.expect_error("velodyne_points/data ... azimuths");
}

TEST(KittiErrors, Timestamps) {
    const KittiDrive drive("times");
    const auto file = drive.file("velodyne_points/timestamps.txt");
    const auto expect = [&](const std::string& text, const std::string& parts) {
        drive.expect_error_with(file, text, "timestamps.txt" + parts);
    };
    const std::string original = read_text(file), line = original.substr(0, original.find('\n') + 1);
    expect(line, " ... 1 ... frame 1 ... line 2");
    expect("2011-13-31 23:59:10.0\n", " line 1 ... 2011-13-31 ... YYYY-MM-DD");
    // nanoseconds overflow 64 bits
    expect("9999-01-01 00:00:00.0\n", " line 1 ... 9999-01-01 ... 1970 ... 2199");
    expect(line + "\n" + line, " line 2 ... empty ... frame 1");
    expect("\n \n", " ... empty");
    expect(line + line + line, " line 2 ... increasing");
    write_text(file, "   " + original);  // leading blanks are allowed
    EXPECT_EQ(drive.load().frames.size(), 3u);
    write_text(file, std::string(1 << 20, '7') + "\n");
    EXPECT_LT(test::find_load_error(drive.folder.string()).size(), 400u);
}

TEST(KittiErrors, Calibration) {
    const KittiDrive drive("calibration");
    const auto expect = [&](const std::string& text, const std::string& parts) {
        drive.expect_error_with(drive.calibration(), text, parts);
    };
    expect("T: 0 0 0\n", "calib_imu_to_velo.txt ... 'R:' ... missing");
    expect("R: 1 0 0 0 1 0 0 0\nT: 0 0 0\n", "calib_imu_to_velo.txt key R ... 8 ... 9");
    expect("R: 1 0 0 0 1 0 0 0 1.01\nT: 0 0 0\n", "calib_imu_to_velo.txt ... rotation");
    expect("R: 1 0 0 0 1 0 0 0 -1\nT: 0 0 0\n", "rotation");
    expect("R: 1 0 0 0 1 0 0 0 1\nT: 0 nan 0\n", "key T: number 2 ... nan");
}

TEST(KittiErrors, PosesFile) {
    const KittiDrive drive("posefile");
    const std::string good = "1 0 0 0 0 1 0 0 0 0 1 0\n";
    const auto expect = [&](const std::string& text, const std::string& parts) {
        write_text(drive.file("poses.txt"), text);
        drive.expect_error(parts, {.poses_file = drive.file("poses.txt")});
    };
    expect(good + "1 0 0 0 0 1 0 0 0 0 1\n" + good, "poses.txt line 2 ... 11 ... 12");
    expect(good + good, "poses.txt ... 2 ... frame 2 ... line 3");
    expect(good + good + "1 0.1 0 0 0 1 0 0 0 0 1 0\n", "poses.txt line 3 ... rotation");
    expect("1 0 0 x 0 1 0 0 0 0 1 0\n" + good + good, "poses.txt line 1 ... number");
}

TEST(KittiErrors, FrameRange) {
    const KittiDrive drive("frames");
    drive.expect_error("frames 10:20 ... [0, 2]", {.frames = {10, 20}});
    drive.expect_error("range 2:2 ... empty", {.frames = {2, 2}});
    EXPECT_THROW(drive.load({.frames = {2, 2}}), UsageError);
}

TEST(KittiErrors, Tracklets) {
    const KittiDrive drive("tracklets");
    const auto file = drive.file("tracklet_labels.xml");
    const std::string original = read_text(file);
    const auto expect = [&](const std::string& from, const std::string& to, const std::string& parts) {
        drive.expect_error_with(file, test::replace_first(original, from, to), parts);
    };
    expect("</tracklets>", "", "tracklet_labels.xml ... malformed");
    expect("<h>2</h>", "<h>0</h>", "box '0' ... 4.4 x 1.8 x 0 m");
    expect("<l>4.4</l>", "<l>nan</l>", "tracklet_labels.xml: track 0: l ... 'nan'");
    expect("<tx>11</tx>", "<tx>inf</tx>", "track 0 frame 2: tx ... 'inf'");
    expect("<w>1.8</w>", "", "track 0: w ... ''");
    expect("<first_frame>1</first_frame>", "<first_frame>1e300</first_frame>",
           "track 0: first_frame ... '1e300'");
    expect("<tx>11</tx>", "<tx>" + std::string(1 << 16, '1') + "</tx>", "track 0 frame 2: tx ... ...'");
    drive.expect_error_with(file, "<html/>", "tracklet_labels.xml ... boost_serialization/tracklets");
}

TEST(Registry, KindsAreRecognisedAndNamed) {
    const KittiDrive drive("kinds");
    EXPECT_EQ(detect_kind(drive.folder), "kitti_raw");
    EXPECT_THROW(detect_kind(drive.folder.parent_path()), DataError);
    EXPECT_THAT(test::find_load_error("kiti_raw:" + drive.folder.string()), test::Names("'kitti_raw'"));
}

}  // namespace
}  // namespace relidar
