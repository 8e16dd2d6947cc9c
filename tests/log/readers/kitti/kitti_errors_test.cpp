// SPDX-License-Identifier: Apache-2.0
// Checks that every defect of a KITTI drive causes an error. The message must be a single
// line with the path, the value in the file, and the expected value.
#include <relidar/log/dataset.hpp>

#include <cmath>
#include <cstring>
#include <functional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>
#include "log/readers/kitti/kitti_drive.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::KittiDrive;
using test::read_text;
using test::write_text;

/// Loads the drive and expects an error with the exit code. The message must be a single
/// line that contains all parts.
void expect_failure(const KittiDrive& drive, const DatasetOptions& options, ExitCode code,
                    const std::vector<std::string>& parts) {
    try {
        load_sequence("kitti_raw:" + drive.folder.string(), options);
        FAIL() << "no failure, expected one with '" << parts[0] << "'";
    } catch (const Error& error) {
        EXPECT_EQ(error.code(), code) << error.what();
        const std::string message = error.what();
        EXPECT_EQ(message.find('\n'), std::string::npos) << message;
        for (const std::string& part : parts) EXPECT_THAT(message, test::Names(part));
    }
}

void expect_data_error(const KittiDrive& drive, const std::vector<std::string>& parts) {
    expect_failure(drive, {}, ExitCode::data, parts);
}

void put_float(std::string& bytes, std::size_t point, std::size_t field, float value) {
    std::memcpy(bytes.data() + 16 * point + 4 * field, &value, 4);
}

TEST(KittiErrors, MissingFoldersAndFiles) {
    const KittiDrive drive("missing");
    EXPECT_THROW(load_sequence("/nowhere/drive", {}), DataError);
    EXPECT_THROW(load_sequence("kitti_raw:/nowhere/drive", {}), DataError);
    fs::remove(drive.file("oxts/data/0000000001.txt"));
    expect_data_error(drive, {"oxts/data/0000000001.txt: no such file"});
    fs::remove_all(drive.file("oxts"));
    expect_data_error(drive, {"oxts/data: the OXTS files", "dataset.poses=FILE", "dataset.poses=none"});
    write_text(drive.file("oxts/data/nan.txt"), "");  // belongs to no frame
    expect_data_error(drive, {"oxts/data: the OXTS files"});
    fs::remove(drive.file("velodyne_points/timestamps_end.txt"));
    expect_data_error(drive, {"timestamps_end.txt: no such file ... copy the file"});
    fs::remove_all(drive.file("velodyne_points/data"));
    expect_data_error(drive, {"velodyne_points/data: no such folder", "expected KITTI raw scans"});
    fs::create_directories(drive.file("velodyne_points/data"));
    expect_data_error(drive, {"velodyne_points/data ... scans"});
}

TEST(KittiErrors, MissingCalibration) {
    const KittiDrive drive("uncalibrated");
    fs::remove(drive.calibration());
    expect_data_error(drive, {"calib_imu_to_velo.txt: no such file", "2011_12_31_calib", "dataset.poses"});
}

TEST(KittiErrors, NumbersOfScans) {
    const KittiDrive drive("numbers");
    write_text(drive.file("velodyne_points/data/2147483646.bin"), "");
    expect_data_error(drive, {"2147483646.bin ... number", "below 100000000"});
    fs::rename(drive.file("velodyne_points/data/2147483646.bin"),
               drive.file("velodyne_points/data/9999999999.bin"));
    expect_data_error(drive, {"9999999999.bin ... number"});
    fs::rename(drive.file("velodyne_points/data/9999999999.bin"),
               drive.file("velodyne_points/data/0099999999.bin"));
    expect_data_error(drive, {"timestamps.txt: found 3 lines, but frame 99999999 needs line 100000000"});
    DatasetOptions complete;
    complete.allow_missing_scans = false;
    expect_failure(drive, complete, ExitCode::data,
                   {"99999996 ... 0 to 99999999 ... missing (3, 4, 5, 6, 7, ...)"});
}

TEST(KittiErrors, FoldersThatAreNoDrive) {
    const KittiDrive drive("strangers");
    const auto expect = [](const fs::path& folder, const std::vector<std::string>& parts) {
        for (const std::string kind : {"", "kitti_raw:"}) {
            try {
                load_sequence(kind + folder.string(), {});
                FAIL() << folder;
            } catch (const DataError& error) {
                for (const std::string& part : parts) EXPECT_THAT(error.what(), test::Names(part));
            }
        }
    };
    expect(drive.folder.parent_path(), {"2011_12_31", "1 dataset", "2011_12_31_drive_0001_sync"});
    expect(drive.file("velodyne_points"), {"inside", "2011_12_31_drive_0001_sync"});
    expect(drive.file("oxts/data"), {"inside"});
    const fs::path odometry = drive.folder.parent_path().parent_path() / "dataset/sequences/00";
    write_text(odometry / "velodyne/000000.bin", "");
    write_text(odometry / "times.txt", "0\n");
    expect(odometry, {"sequences/00", "KITTI odometry ... motion-compensated", "KITTI raw"});
    expect(odometry.parent_path().parent_path(), {"KITTI odometry"});
    for (int frame = 0; frame < 3; ++frame)
        fs::rename(drive.scan(frame), drive.scan(frame).replace_extension("txt"));
    expect_data_error(drive, {"text", "_extract", "_sync"});
}

TEST(KittiErrors, PosesOutOfThisWorld) {
    const KittiDrive drive("far");
    const std::string good = "1 0 0 0 0 1 0 0 0 0 1 0\n";
    DatasetOptions options;
    options.poses_file = drive.file("poses.txt");
    write_text(options.poses_file, good + "1 0 0 1e308 0 1 0 0 0 0 1 0\n" + good);
    expect_failure(drive, options, ExitCode::data, {"poses.txt ... frame 1 ... (1e+308, 0, 0)"});
    write_text(options.poses_file, good + "1 0 0 2e5 0 1 0 0 0 0 1 0\n" + good);
    expect_failure(drive, options, ExitCode::data, {"poses.txt ... frames 0 and 1 ... 200000 m"});
    const fs::path oxts = drive.file("oxts/data/0000000002.txt");
    write_text(oxts, read_text(oxts).replace(read_text(oxts).find("100.5"), 5, "1e308"));
    expect_data_error(drive, {"oxts/data ... pose of frame 2 ... ("});
}

TEST(KittiErrors, ScanErrorCollector) {
    const KittiDrive drive("scans");
    const std::string original = read_text(drive.scan(1));
    write_text(drive.scan(1), original.substr(0, 100));
    expect_data_error(drive,
                      {"0000000001.bin ... truncated ... 100 bytes", "4 more bytes", "6 points of 16 bytes"});
    write_text(drive.scan(1), "");
    expect_data_error(drive, {"0000000001.bin ... empty"});
    std::string bad = original;
    put_float(bad, 5, 3, INFINITY);
    write_text(drive.scan(1), bad);
    expect_data_error(drive, {"point 5", "intensity inf"});
    bad = original;
    put_float(bad, 8, 0, 2e4f);
    write_text(drive.scan(1), bad);
    expect_data_error(drive, {"point 8", "10000 m"});
    for (int frame = 0; frame < 3; ++frame) write_text(drive.scan(frame), original.substr(0, 16 * 3000));
    expect_data_error(drive, {"velodyne_points/data: ", "rings ... 64"});
}

/// Returns 64 rings of points at even azimuths, stored ring by ring as in KITTI.
std::string make_even_scan(double step_rad, int n_a_ring) {
    std::string bytes;
    for (int ring = 0; ring < 64; ++ring) {
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
    }
    return bytes;
}

TEST(KittiErrors, AzimuthStepsOfNoSensor) {
    const KittiDrive drive("steps");
    for (int frame = 0; frame < 3; ++frame) write_text(drive.scan(frame), make_even_scan(2e-5, 1000));
    expect_data_error(drive, {"velodyne_points/data ... azimuths ... degrees", "8192 firings"});
}

TEST(KittiErrors, Timestamps) {
    const KittiDrive drive("times");
    const auto file = drive.file("velodyne_points/timestamps.txt");
    const std::string original = read_text(file);
    write_text(file, original.substr(0, original.find('\n') + 1));
    expect_data_error(drive, {"timestamps.txt: found 1 lines, but frame 1 needs line 2"});
    write_text(file, "2011-13-31 23:59:10.0\n");
    expect_data_error(drive, {"timestamps.txt line 1", "2011-13-31", "expected YYYY-MM-DD"});
    write_text(file, "9999-01-01 00:00:00.0\n");  // nanoseconds overflow 64 bits
    expect_data_error(drive, {"timestamps.txt line 1", "9999-01-01", "1970 and 2199"});
    write_text(file, std::string(1 << 20, '7') + "\n");
    try {
        load_sequence(drive.folder.string(), {});
        FAIL();
    } catch (const DataError& error) {
        EXPECT_LT(std::string(error.what()).size(), 400u);
    }
    const std::string line = original.substr(0, original.find('\n') + 1);
    write_text(file, line + "\n" + line);
    expect_data_error(drive, {"timestamps.txt line 2 ... empty ... frame 1"});
    write_text(file, "\n \n");
    expect_data_error(drive, {"timestamps.txt ... empty"});
    write_text(file, "   " + original);  // leading blanks are allowed
    EXPECT_EQ(load_sequence(drive.folder.string(), {}).frames.size(), 3u);
    write_text(file, line + line + line);
    expect_data_error(drive, {"timestamps.txt line 2", "increasing"});
}

TEST(KittiErrors, Calibration) {
    const KittiDrive drive("calibration");
    const auto expect = [&](const std::string& text, const std::vector<std::string>& parts) {
        write_text(drive.calibration(), text);
        expect_data_error(drive, parts);
    };
    expect("T: 0 0 0\n", {"calib_imu_to_velo.txt ... 'R:' ... missing"});
    expect("R: 1 0 0 0 1 0 0 0\nT: 0 0 0\n", {"calib_imu_to_velo.txt key R: found 8 numbers, expected 9"});
    expect("R: 1 0 0 0 1 0 0 0 1.01\nT: 0 0 0\n", {"calib_imu_to_velo.txt", "rotation", "orthonormal"});
    expect("R: 1 0 0 0 1 0 0 0 -1\nT: 0 0 0\n", {"rotation"});
    expect("R: 1 0 0 0 1 0 0 0 1\nT: 0 nan 0\n", {"key T: number 2 is nan"});
}

TEST(KittiErrors, PosesFile) {
    const KittiDrive drive("posefile");
    const std::string good = "1 0 0 0 0 1 0 0 0 0 1 0\n";
    DatasetOptions options;
    options.poses_file = drive.file("poses.txt");
    const auto expect = [&](const std::string& text, const std::vector<std::string>& parts) {
        write_text(options.poses_file, text);
        expect_failure(drive, options, ExitCode::data, parts);
    };
    expect(good + "1 0 0 0 0 1 0 0 0 0 1\n" + good, {"poses.txt line 2: found 11 numbers, expected 12"});
    expect(good + good, {"poses.txt: found 2 lines, but frame 2 needs line 3"});
    expect(good + good + "1 0.1 0 0 0 1 0 0 0 0 1 0\n", {"poses.txt line 3", "rotation"});
    expect("1 0 0 x 0 1 0 0 0 0 1 0\n", {"poses.txt line 1 ... number"});
}

TEST(KittiErrors, FrameRange) {
    const KittiDrive drive("frames");
    DatasetOptions options;
    options.frames = {10, 20};
    expect_failure(drive, options, ExitCode::usage, {"frames 10:20", "[0, 2]"});
    options.frames = {2, 2};
    expect_failure(drive, options, ExitCode::usage, {"range 2:2", "empty"});
}

TEST(KittiErrors, Tracklets) {
    const KittiDrive drive("tracklets");
    const auto file = drive.file("tracklet_labels.xml");
    const std::string original = read_text(file);
    const auto expect = [&](const std::string& from, const std::string& to,
                            const std::vector<std::string>& parts) {
        std::string text = original;
        write_text(file, text.replace(text.find(from), from.size(), to));
        expect_data_error(drive, parts);
    };
    expect("</tracklets>", "", {"tracklet_labels.xml ... malformed"});
    expect("<h>2</h>", "<h>0</h>", {"tracklet_labels.xml: track 0", "lengths ... 0"});
    expect("<l>4.4</l>", "<l>nan</l>", {"tracklet_labels.xml: track 0: l ... 'nan'"});
    expect("<tx>11</tx>", "<tx>inf</tx>", {"track 0 frame 2: tx is 'inf'"});
    expect("<w>1.8</w>", "", {"track 0: w ... ''"});
    expect("<first_frame>1</first_frame>", "<first_frame>1e300</first_frame>",
           {"track 0: first_frame is '1e300'"});
    expect("<tx>11</tx>", "<tx>" + std::string(1 << 16, '1') + "</tx>", {"track 0 frame 2: tx", "...'"});
    write_text(file, "<html/>");
    expect_data_error(drive, {"tracklet_labels.xml: the element boost_serialization/tracklets ... missing"});
}

TEST(Registry, KindsAreRecognisedAndNamed) {
    const KittiDrive drive("kinds");
    EXPECT_EQ(detect_dataset_kind(drive.folder), "kitti_raw");
    EXPECT_THROW(detect_dataset_kind(drive.folder.parent_path()), DataError);
    try {
        load_sequence("kiti_raw:" + drive.folder.string(), {});
        FAIL();
    } catch (const UsageError& error) {
        EXPECT_THAT(error.what(), test::Names("'kitti_raw'"));
    }
}

}  // namespace
}  // namespace relidar
