// SPDX-License-Identifier: Apache-2.0
// Reads point files and poses in the conventions of other programs: text files, numpy
// arrays with named fields, pose files with different orders, and points without rings.
#include <cmath>
#include <random>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <relidar/base/error.hpp>

#include "../../../base/codecs/temporary_folder.hpp"
#include "log/readers/folder/point_log.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::expect_street;
using test::kStamped;
using test::make_fresh_folder_path;
using test::PointLog;

TEST(OtherPrograms, CsvWithAHeader) {
    const auto csv = [](const test::FilePoints& points) {
        std::string text = "//X,Y,Z,scalar_intensity,Ring,Timestamp\r\n";
        for (const test::FilePoint& p : points)
            text += fmt::format("{},{},{},{},{},{:.9f}\r\n", p.point_m.x, p.point_m.y, p.point_m.z,
                                std::round(255.0f * p.intensity), p.ring, p.time_s);
        return text;
    };
    expect_street({"csv", "csv", csv, R"(, "point_times": "absolute")"}, 1e-6);
}
TEST(OtherPrograms, XyzOfColumns) {
    const auto xyz = [](const test::FilePoints& points) {
        std::string text;
        for (const test::FilePoint& p : points)
            text +=
                fmt::format("{} {} {} {} {}\n", p.point_m.x, p.point_m.y, p.point_m.z, p.intensity, p.ring);
        return text;
    };
    expect_street({"xyz", "xyz", xyz, R"(, "columns": ["x", "y", "z", "intensity", "ring"])"}, 1e-4);
}
TEST(OtherPrograms, NpyWithNamedFields) {
    const auto npy = [](const test::FilePoints& points) {
        // Header that numpy writes for an aligned dtype. An unnamed field fills a gap.
        std::string header = fmt::format(
            "{{'descr': [('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('intensity', '|u1'), ('', '|V1'), "
            "('ring', '<u2'), ('normal', '<f4', (3,)), ('t', '<f8')], 'fortran_order': False, 'shape': "
            "({},), "
            "}}",
            points.size());
        header.resize(310, ' ');
        std::string bytes = std::string("\x93NUMPY\x01\x00", 8) + char(310 % 256) + char(310 / 256) + header;
        const auto append = [&](const auto& value) {
            bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
        };
        for (const test::FilePoint& p : points) {
            append(p.point_m);
            append(std::uint8_t(std::lround(255.0f * p.intensity)));
            append('\0');
            append(p.ring);
            append(glm::vec3(7.0f));
            append(p.time_s);
        }
        return bytes;
    };
    expect_street({"npy_fields", "npy", npy, kStamped}, 1e-6);
}
TEST(OtherPrograms, Las) {
    const auto scan = [](const test::FilePoints& points) { return test::las(points, 100.0); };
    expect_street({"las", "las", scan, kStamped}, 1e-6);
    const auto complaint = [](const PointLog& log) {
        return error_message<DataError>([&] { load_sequence(log.folder.string(), {}); });
    };
    const auto survey = [](test::FilePoints points) {
        for (test::FilePoint& p : points) p.point_m.x += 500.0f;
        return test::las(points);
    };
    EXPECT_THAT(complaint({"las_map", "las", survey, ""}), test::Names("survey"));
    const auto packed = [](const test::FilePoints& points) { return test::las(points, 0.0, 128 + 1); };
    EXPECT_THAT(complaint({"las_packed", "las", packed, ""}), test::Names("laszip"));
    const auto cut = [](const test::FilePoints& points) { return test::las(points).substr(0, 5000); };
    EXPECT_THAT(complaint({"las_cut", "las", cut, ""}), test::Names("truncated"));
}

TEST(OtherPrograms, NotesIntensitiesThatAreAllTheSame) {
    const auto constant = [](test::FilePoints points) {
        for (test::FilePoint& p : points) p.intensity = 0.5f;
        return test::bin(points);
    };
    const PointLog log("constant", "bin", constant, R"(, "columns": ["x", "y", "z", "intensity", "ring"])");
    EXPECT_THAT(load_sequence(log.folder.string(), {}).notes,
                testing::Contains(test::Names("intensities ... 0.5")));
}

TEST(OtherPrograms, NamesTheToolForOtherFormats) {
    const fs::path folder = make_fresh_folder_path("other_formats");
    fs::create_directories(folder / "scans");
    const auto complaint = [](const fs::path& path) -> std::string {
        try {
            load_sequence(path.string(), {});
        } catch (const DataError& error) {
            return error.what();
        }
        return "";
    };
    for (const auto& [name, tool] : {std::pair("a.laz", "pdal"), std::pair("a.E57", "pdal"),
                                     std::pair("a.lvx", "livox_ros_driver"), std::pair("a.osf", "ouster-cli"),
                                     std::pair("a.bag.gz", "gunzip"), std::pair("a.db3.zstd", "zstd")}) {
        test::write_text(folder / name, "content");
        EXPECT_THAT(complaint(folder / name), test::Names(tool));
        EXPECT_THAT(complaint(folder), test::Names(tool));
        fs::remove(folder / name);
    }
    test::write_text(folder / "scans/a.laz", "content");
    test::write_text(folder / "sequence.json", R"({"format": "relidar log", "version": 1, "rate_hz": 10})");
    EXPECT_NE(complaint(folder).find("pdal"), std::string::npos) << complaint(folder);
    fs::rename(folder / "scans/a.laz", folder / "scans/a.las");
    test::write_text(folder / "poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n");
    EXPECT_THAT(complaint(folder), test::Names("LASF"));
}

TEST(OtherPrograms, ReadsPosesOfOtherConventions) {
    const PointLog log("conventions", "bin", test::bin,
                       R"(, "columns": ["x", "y", "z", "intensity", "ring"])");
    const PoseTrack& truth = log.street.world_from_vehicle;
    // The poses begin before the scans, because their convention needs a long motion.
    const auto write = [&](const auto& numbers) {
        std::string text;
        for (double t_s = -1.0; t_s < 1.55; t_s += 0.1) {
            text += fmt::format("{}", t_s);
            for (const double v : numbers(truth.interpolate_pose(t_s))) text += fmt::format(" {:.15f}", v);
            text += "\n";
        }
        test::write_text(log.folder / "poses.txt", text);
    };
    const auto expect = [&](const std::string& note, const Pose& of_vehicle) {
        const LidarSequence sequence = load_sequence(log.folder.string(), {});
        const PoseTrack world =
            add_offset_to_track_positions(sequence.world_from_vehicle, sequence.world_offset_m);
        for (std::size_t i = 0; i < world.pose.size(); ++i) {
            const Pose off = inverse(truth.pose[i] * of_vehicle) * world.pose[i];
            EXPECT_LT(glm::length(off.translation), 1e-6) << note;
            EXPECT_GT(std::abs(off.rotation.w), 1.0 - 1e-9) << note;
        }
        const auto named = testing::Contains(test::Names("poses ... read ... " + note));
        EXPECT_EQ(testing::Value(sequence.notes, named), !note.empty()) << note;
    };
    using Numbers = std::vector<double>;
    const auto w_first = [](const Pose& p) {
        const auto& [q, t] = p;
        return Numbers{t.x, t.y, t.z, q.w, q.x, q.y, q.z};
    };
    write(w_first);
    expect("", Pose{});
    write([](const Pose& p) {
        const auto& [q, t] = p;
        return Numbers{t.x, t.y, t.z, q.x, q.y, q.z, q.w};
    });
    expect("qx qy qz qw", Pose{});
    write([&](const Pose& p) { return w_first(inverse(p)); });
    expect("qw qx qy qz, from the world to the sensor", Pose{});
    for (const double unit : {1.0, 180.0 / kPi}) {
        write([&](const Pose& p) {
            const glm::dmat3 m = glm::mat3_cast(p.rotation);
            const double yaw = std::atan2(m[0][1], m[0][0]), pitch = -std::asin(m[0][2]),
                         roll = std::atan2(m[1][2], m[2][2]);
            return Numbers{p.translation.x, p.translation.y, p.translation.z,
                           unit * roll,     unit * pitch,    unit * yaw};
        });
        if (unit == 1.0) expect("", Pose{});
    }
    // The poses of a vehicle that drives backwards look like inverse poses. The reader
    // must decide by the scans.
    const Pose backwards{glm::dquat(0.0, 0.0, 0.0, 1.0), {}};
    test::write_text(
        log.folder / "sequence.json",
        R"({"format": "relidar log", "version": 1, "rate_hz": 10, "columns": ["x", "y", "z", "intensity", "ring"],
            "lidars": [{"vehicle_from_sensor": {"translation": [0, 0, 0], "quaternion": [0, 0, 0, 1]}}]})");
    write([&](const Pose& p) { return w_first(p * backwards); });
    expect("", backwards);
}

TEST(OtherPrograms, TheScansDecideTheOrderOfQuaternions) {
    // The street is driven in four directions, forward and backward. The mounting of the
    // LiDAR says where the front of the vehicle is.
    const PointLog log("orders", "bin", test::bin, R"(, "columns": ["x", "y", "z", "intensity", "ring"])");
    const PoseTrack& truth = log.street.world_from_vehicle;
    for (const bool is_backward : {false, true}) {
        const Pose front{is_backward ? glm::dquat(0, 0, 0, 1) : glm::dquat(1, 0, 0, 0), {}};
        test::write_text(log.folder / "sequence.json",
                         fmt::format(
                             R"({{"format": "relidar log", "version": 1, "rate_hz": 10,
                     "columns": ["x", "y", "z", "intensity", "ring"], "lidars": [{{"vehicle_from_sensor":
                     {{"translation": [0, 0, 0], "quaternion": [{}, 0, 0, {}]}}}}]}})",
                             front.rotation.w, front.rotation.z));
        for (const double heading_deg : {0.0, 90.0, 180.0, 270.0})
            for (const bool is_scalar_last : {false, true}) {
                const Pose turned{make_rotation(heading_deg * kPi / 180.0, 0, 0), {}};
                std::string text;
                for (double t_s = -1.0; t_s < 1.55; t_s += 0.1) {
                    const auto& [q, t] = turned * truth.interpolate_pose(t_s) * front;
                    text += fmt::format("{} {} {} {}", t_s, t.x, t.y, t.z);
                    text += is_scalar_last ? fmt::format(" {} {} {} {}\n", q.x, q.y, q.z, q.w)
                                           : fmt::format(" {} {} {} {}\n", q.w, q.x, q.y, q.z);
                }
                test::write_text(log.folder / "poses.txt", text);
                const LidarSequence sequence = load_sequence(log.folder.string(), {});
                const Pose off =
                    inverse(turned * truth.pose[2] * front) * sequence.world_from_vehicle.pose[2];
                EXPECT_GT(std::abs(off.rotation.w), 1.0 - 1e-9)
                    << heading_deg << " degrees, backward " << is_backward << ", w last " << is_scalar_last;
                EXPECT_EQ(testing::Value(sequence.notes, testing::Contains(testing::HasSubstr("poses.txt"))),
                          is_scalar_last);
            }
    }
}

TEST(OtherPrograms, PosesWithoutTimesAreRefused) {
    const PointLog log("untimed", "bin", test::bin, R"(, "columns": ["x", "y", "z", "intensity", "ring"])");
    std::string text;
    for (int i = 0; i < 4; ++i) text += fmt::format("{} 0 0 1 0 0 0\n", i);  // x y z and a quaternion
    test::write_text(log.folder / "poses.txt", text);
    EXPECT_THAT(error_message<DataError>([&] { load_sequence(log.folder.string(), {}); }),
                test::Names("poses ... times"));
}

TEST(OtherPrograms, ATableOfTimesIsNotAScan) {
    const PointLog log("times", "bin", test::bin, R"(, "columns": ["x", "y", "z", "intensity", "ring"])");
    test::write_text(log.folder / "scans" / "timestamps.csv", "frame,time\n0,0.0\n1,0.1\n");
    EXPECT_EQ(load_sequence(log.folder.string(), {}).frames.size(), 4u);
}

TEST(OtherPrograms, FindsRingsInTheOrderOfTheFile) {
    // The beams of an HDL-64E start far from the sensor's centre, so their elevations
    // overlap.
    const test::KittiDrive drive("file_order");
    const fs::path folder = make_fresh_folder_path("file_order");
    fs::create_directories(folder / "scans");
    for (int frame = 0; frame < 3; ++frame)
        fs::copy_file(drive.scan(frame), folder / "scans" / fmt::format("{}.bin", frame));
    test::write_text(folder / "sequence.json", R"({"format": "relidar log", "version": 1, "rate_hz": 10})");
    DatasetOptions options;
    options.poses_file = kNoPoses;
    const LidarSequence kitti = load_sequence(drive.folder.string(), {}),
                        plain = load_sequence(folder.string(), options);
    ASSERT_EQ(plain.lidars[0].sensor.beams.size(), 64u);
    for (std::size_t b = 0; b < 64; ++b)
        EXPECT_NEAR(plain.lidars[0].sensor.beams[b].elevation_rad, drive.beams[b].elevation_rad, 0.03) << b;
    for (std::size_t f = 0; f < 3; ++f) {
        const double n = double(kitti.frames[f].scan.count_returns());
        EXPECT_NEAR(double(plain.frames[f].scan.count_returns()) / n, 1.0, 0.01);
    }
}

TEST(OtherPrograms, InventsNoBeamsForThinnedClouds) {
    const auto thinned = [](const test::FilePoints& points) {
        std::mt19937 random(7);
        test::FilePoints some;
        for (const test::FilePoint& point : points)
            if (random() % 100 < 25) some.push_back(point);
        return test::bin(some);
    };
    const PointLog log("thinned", "bin", thinned, R"(, "columns": ["x", "y", "z", "intensity", "unused"])");
    const LidarSequence sequence = load_sequence(log.folder.string(), {});
    EXPECT_TRUE(sequence.lidars[0].sensor.beams.empty());
    EXPECT_TRUE(std::ranges::any_of(sequence.notes, [](const std::string& n) {
        return n.find("removed") != n.npos || n.find("order") != n.npos;
    }));
}

}  // namespace
}  // namespace relidar
