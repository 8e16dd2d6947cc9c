// SPDX-License-Identifier: Apache-2.0
#include <bit>
#include <cstring>
#include <random>

#include <relidar/base/arrays.hpp>

#include "read/datasets/folder/point_log.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::expect_street;
using test::kRings;
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
    expect_street({"xyz", "xyz", xyz, kRings}, 1e-4);
}
TEST(OtherPrograms, NpyWithNamedFields) {
    const auto npy = [](const test::FilePoints& points) {
        // Header that numpy writes for an aligned dtype. An unnamed field fills a gap.
        std::string header = fmt::format(
            "{{'descr': [('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('intensity', '|u1'), ('', '|V1'), "
            "('ring', '<u2'), ('normal', '<f4', (3,)), ('t', '<f8')], 'fortran_order': False, 'shape': "
            "({},), }}",
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
    const auto complaint = [](const PointLog& files) { return test::find_load_error(files.folder.string()); };
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
    const PointLog files("constant", "bin", test::bin, kRings);
    for (std::size_t i = 0; i < files.street.frames.size(); ++i)
        files.change_points(i, [](test::FilePoint& p) { p.intensity = 0.5f; });
    EXPECT_THAT(files.load().notes, testing::Contains(test::Names("intensities ... 0.5")));
}

TEST(OtherPrograms, NotesDarkIntensitiesOfRellis) {
    const PointLog files("rellis", "bin", test::bin, kRings);
    float highest = 0.0f;
    for (const Frame& frame : files.street.frames)
        for (const test::FilePoint& p : PointLog::points(frame)) highest = std::max(highest, p.intensity);
    for (std::size_t i = 0; i < files.street.frames.size(); ++i)
        files.change_points(i, [&](test::FilePoint& p) { p.intensity *= 0.0119f / highest; });
    EXPECT_THAT(files.load().notes,
                testing::Contains(test::Names("0.0119 ... dark ... conventions.intensity_max")));
    EXPECT_THAT(files.load({.conventions = {.intensity_max = 0.0119}}).notes,
                testing::Not(testing::Contains(test::Names("intensit"))));
}

TEST(OtherPrograms, NamesTheToolForOtherFormats) {
    const fs::path folder = make_fresh_folder_path("other_formats");
    fs::create_directories(folder / "scans");
    const auto complaint = [](const fs::path& path) { return test::find_load_error(path.string()); };
    for (const auto& [name, tool] : {std::pair("a.laz", "pdal"), std::pair("a.E57", "pdal"),
                                     std::pair("a.lvx", "livox_ros_driver"), std::pair("a.osf", "ouster-cli"),
                                     std::pair("a.bag.gz", "gunzip"), std::pair("a.db3.zstd", "zstd")}) {
        test::write_text(folder / name, "content");
        EXPECT_THAT(complaint(folder / name), test::Names(tool));
        EXPECT_THAT(complaint(folder), test::Names(tool));
        fs::remove(folder / name);
    }
    test::write_text(folder / "scans/a.laz", "content");
    test::write_text(folder / "sequence.json", test::make_head());
    EXPECT_THAT(complaint(folder), test::Names("pdal"));
    fs::rename(folder / "scans/a.laz", folder / "scans/a.las");
    test::write_text(folder / "poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n");
    EXPECT_THAT(complaint(folder), test::Names("LASF"));
}

std::string make_mounting(const Pose& turned) {
    return fmt::format(R"(, "lidars": [{{"vehicle_from_sensor": {{"translation": [0, 0, 0],
                              "quaternion": [{}, 0, 0, {}]}}}}])",
                       turned.rotation.w, turned.rotation.z);
}

TEST(OtherPrograms, ReadsPosesOfOtherConventions) {
    const PointLog files("conventions", "bin", test::bin, kRings);
    const PoseTrack& truth = files.street.world_from_vehicle;
    // The poses begin before the scans, because their convention needs a long motion.
    const auto write = [&](const auto& numbers) {
        std::string text;
        for (double t_s = -1.0; t_s < 1.55; t_s += 0.1) {
            text += fmt::format("{}", t_s);
            for (const double v : numbers(truth.pose_at(t_s))) text += fmt::format(" {:.15f}", v);
            text += "\n";
        }
        test::write_text(files.folder / "poses.txt", text);
    };
    const auto expect = [&](const std::string& guess, const Pose& of_vehicle) {
        const Log log = files.load();
        const PoseTrack world = shift_track(log.world_from_vehicle, log.world_offset_m);
        for (std::size_t i = 0; i < world.pose.size(); ++i) {
            const Pose off = inverse(truth.pose[i] * of_vehicle) * world.pose[i];
            EXPECT_LT(glm::length(off.translation), 1e-6) << guess;
            EXPECT_GT(std::abs(off.rotation.w), 1.0 - 1e-9) << guess;
        }
        const auto is_guessed = [&](const UsedConvention& used) {
            return used.from.starts_with("guess: ") && used.value == guess;
        };
        EXPECT_EQ(std::ranges::any_of(log.conventions_used, is_guessed), !guess.empty()) << guess;
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
    expect("x y z w", Pose{});
    write([&](const Pose& p) { return w_first(inverse(p)); });
    expect("sensor from world", Pose{});
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
    files.put_head(kRings + make_mounting(backwards));
    write([&](const Pose& p) { return w_first(p * backwards); });
    expect("", backwards);
}

TEST(OtherPrograms, TheScansDecideTheOrderOfQuaternions) {
    // The street is driven in four directions, forward and backward. The mounting of the
    // LiDAR says where the front of the vehicle is.
    const PointLog files("orders", "bin", test::bin, kRings);
    const PoseTrack& truth = files.street.world_from_vehicle;
    for (const bool is_backward : {false, true}) {
        const Pose front{is_backward ? glm::dquat(0, 0, 0, 1) : glm::dquat(1, 0, 0, 0), {}};
        files.put_head(kRings + make_mounting(front));
        for (const double heading_deg : {0.0, 90.0, 180.0, 270.0})
            for (const bool is_scalar_last : {false, true}) {
                const Pose turned{make_rotation(heading_deg * kPi / 180.0, 0, 0), {}};
                std::string text;
                for (double t_s = -1.0; t_s < 1.55; t_s += 0.1) {
                    const auto& [q, t] = turned * truth.pose_at(t_s) * front;
                    text += fmt::format("{} {} {} {}", t_s, t.x, t.y, t.z);
                    text += is_scalar_last ? fmt::format(" {} {} {} {}\n", q.x, q.y, q.z, q.w)
                                           : fmt::format(" {} {} {} {}\n", q.w, q.x, q.y, q.z);
                }
                test::write_text(files.folder / "poses.txt", text);
                const Log log = files.load();
                const Pose off = inverse(turned * truth.pose[2] * front) * log.world_from_vehicle.pose[2];
                EXPECT_GT(std::abs(off.rotation.w), 1.0 - 1e-9)
                    << heading_deg << " degrees, backward " << is_backward << ", w last " << is_scalar_last;
                const auto order =
                    std::ranges::find(log.conventions_used, "quaternions", &UsedConvention::name);
                ASSERT_NE(order, log.conventions_used.end());
                EXPECT_EQ(order->value, is_scalar_last ? "x y z w" : "w x y z");
            }
    }
}

TEST(OtherPrograms, PosesWithoutTimesAreRefused) {
    const PointLog files("untimed", "bin", test::bin, kRings);
    std::string text;
    for (int i = 0; i < 4; ++i) text += fmt::format("{} 0 0 1 0 0 0\n", i);  // x y z and a quaternion
    test::write_text(files.folder / "poses.txt", text);
    EXPECT_THAT(test::find_load_error(files.folder.string()), test::Names("poses ... times"));
}

TEST(OtherPrograms, ATableOfTimesIsNotAScan) {
    const PointLog files("times", "bin", test::bin, kRings);
    test::write_text(files.folder / "scans" / "timestamps.csv", "frame,time\n0,0.0\n1,0.1\n");
    EXPECT_EQ(files.load().frames.size(), 4u);
}

TEST(OtherPrograms, FindsRingsInTheOrderOfTheFile) {
    // The beams of an HDL-64E start far from the sensor's centre, so their elevations
    // overlap.
    const test::KittiDrive drive("file_order");
    const fs::path folder = make_fresh_folder_path("file_order");
    fs::create_directories(folder / "scans");
    for (int frame = 0; frame < 3; ++frame)
        fs::copy_file(drive.scan(frame), folder / "scans" / fmt::format("{}.bin", frame));
    test::write_text(folder / "sequence.json", test::make_head());
    const Log kitti = drive.load(), plain = load_log(folder.string(), {.poses_file = kNoPoses});
    ASSERT_EQ(plain.lidars[0].sensor.beams.size(), 64u);
    for (std::size_t b = 0; b < 64; ++b)
        EXPECT_NEAR(plain.lidars[0].sensor.beams[b].elevation_rad, drive.beams[b].elevation_rad, 0.03) << b;
    for (std::size_t f = 0; f < 3; ++f) {
        const double n = double(kitti.frames[f].scan.count_returns());
        EXPECT_NEAR(double(plain.frames[f].scan.count_returns()) / n, 1.0, 0.01);
    }
}

TEST(OtherPrograms, FindsRingsOfKittiOdometry) {
    // All points are moved to the time at which the head faces forward. In a curve, the
    // azimuths behind the sensor, where a sweep begins and ends, then overlap by 5
    // degrees.
    const test::KittiDrive drive("odometry_order");
    const fs::path folder = make_fresh_folder_path("odometry_order");
    for (int frame = 0; frame < 3; ++frame) {
        std::string bytes = test::read_text(drive.scan(frame));
        const std::size_t last_point = bytes.size() - sizeof(glm::vec4);
        for (std::size_t at = 0; at <= last_point; at += sizeof(glm::vec4)) {
            glm::vec4 point;
            std::memcpy(&point, bytes.data() + at, sizeof point);
            const double turns = -std::atan2(double(point.y), double(point.x)) / (2.0 * kPi);
            const Pose forward_from_firing{make_rotation(-0.09 * turns, 0, 0), {1.5 * turns, 0, 0}};
            point = glm::vec4(glm::vec3(forward_from_firing * glm::dvec3(point)), point.w);
            std::memcpy(bytes.data() + at, &point, sizeof point);
        }
        if (frame == 1) bytes += bytes.substr(0, sizeof(glm::vec4));  // a stray point after the last ring
        test::write_text(folder / "scans" / fmt::format("{}.bin", frame), bytes);
    }
    test::write_text(folder / "sequence.json", test::make_head());
    const Log log = load_log(folder.string(), {.poses_file = kNoPoses});
    ASSERT_EQ(log.lidars[0].sensor.beams.size(), 64u);
    // Points of the overlap can have the same ray.
    EXPECT_GT(double(log.frames[0].scan.count_returns()), 0.98 * double(drive.n_points));
}

TEST(OtherPrograms, InventsNoBeamsForThinnedClouds) {
    const auto thinned = [](const test::FilePoints& points) {
        std::mt19937 random(7);
        test::FilePoints some;
        for (const test::FilePoint& point : points)
            if (random() % 100 < 25) some.push_back(point);
        return test::bin(some);
    };
    const PointLog files("thinned", "bin", thinned, test::kNoRings);
    const Log log = files.load();
    EXPECT_TRUE(log.lidars[0].sensor.beams.empty());
    EXPECT_TRUE(std::ranges::any_of(log.notes, [](const std::string& n) {
        return n.find("removed") != n.npos || n.find("order") != n.npos;
    }));
}

TEST(OtherPrograms, PcdPaddingOfCountZero) {
    int n = 0;
    for (const char* data : {"ascii", "binary", "binary_compressed"}) {
        const auto without = [&](const test::FilePoints& points) { return test::make_pcd(points, data, 0); };
        // some programs write COUNT 0 although the file contains the padding
        const auto with = [&](const test::FilePoints& points) {
            return test::replace_first(test::make_pcd(points, data, 3), "COUNT 1 1 1 3", "COUNT 1 1 1 0");
        };
        const auto several = [&](const test::FilePoints& points) {
            std::string text =
                test::replace_first(without(points), "timestamp\nSIZE 4", "timestamp _\nSIZE 4");
            text = test::replace_first(std::move(text), "2 8\nTYPE", "2 8 4\nTYPE");
            text = test::replace_first(std::move(text), "U U U F\n", "U U U F F\n");
            return test::replace_first(std::move(text), "0 1 1 1\n", "0 1 1 1 0\n");
        };
        expect_street({fmt::format("count_0_{}", n), "pcd", without, kStamped}, 1e-6);
        expect_street({fmt::format("count_0_padded_{}", n), "pcd", with, kStamped}, 1e-6);
        expect_street({fmt::format("count_0_several_{}", n++), "pcd", several, kStamped}, 1e-6);
    }
}

/// Every seventh ray has a weaker return at half the range, others repeat their return.
test::FilePoints make_second_returns(test::FilePoints points) {
    for (std::size_t i = 0; i < points.size(); i += 7) {
        points[i].point_m *= 0.5f;
        points[i].intensity = 0.0f;
    }
    return points;
}

TEST(OtherPrograms, TwoReturnsWithoutNumbers) {
    const auto in_turn = [](const test::FilePoints& points) {
        test::FilePoints all;
        for (std::size_t i = 0; i < points.size(); ++i) {
            all.push_back(make_second_returns(points)[i]);
            all.push_back(points[i]);
        }
        return test::make_pcd_binary(all);
    };
    const auto in_halves = [](const test::FilePoints& points) {
        test::FilePoints all = make_second_returns(points);
        all.insert(all.end(), points.begin(), points.end());
        return test::make_ply_binary(all);
    };
    const auto in_blocks = [](const test::FilePoints& points) {
        test::FilePoints all;
        for (std::size_t first = 0; first < points.size(); first += 50 + first % 7)
            for (const test::FilePoints& some : {points, make_second_returns(points)})
                for (std::size_t i = first; i < std::min(first + 50 + first % 7, points.size()); ++i)
                    all.push_back(some[i]);
        return test::make_pcd_binary(all);
    };
    const auto without_repetition = [](const test::FilePoints& points) {
        test::FilePoints all = points;
        for (std::size_t i = 0; i < points.size(); i += 7) all.push_back(make_second_returns(points)[i]);
        return test::make_pcd_binary(all);
    };
    const std::function<std::string(const test::FilePoints&)> layouts[] = {in_turn, in_halves, in_blocks,
                                                                           without_repetition};
    for (std::size_t k = 0; k < std::size(layouts); ++k) {
        const PointLog files(fmt::format("two_returns_{}", k), k == 1 ? "ply" : "pcd", layouts[k],
                             k == 1 ? R"(, "point_times": "absolute")" : kStamped);
        expect_street(files, 1e-6);
        const Log log = files.load();
        EXPECT_THAT(log.notes, testing::Contains(test::Names("two returns")));
        for (std::size_t f = 0; f < log.frames.size(); ++f) {
            const Scan &scan = log.frames[f].scan, &truth = files.street.frames[f].scan;
            ASSERT_EQ(scan.second_returns.size(), 1u) << k;
            for (std::size_t ray = 0, point = 0; ray < truth.range_m.size(); ++ray) {
                const bool is_second = truth.range_m[ray] > 0.0f && point++ % 7 == 0;
                EXPECT_NEAR(scan.second_returns[0].range_m[ray], is_second ? 0.5f * truth.range_m[ray] : 0.0f,
                            1e-3f);
            }
        }
    }
}

TEST(OtherPrograms, NpzWithPoints) {
    const auto npz = [](const test::FilePoints& points) {
        std::vector<float> xyzi, rings, times;
        for (const test::FilePoint& p : points) {
            for (const float v : {p.point_m.x, p.point_m.y, p.point_m.z, p.intensity}) xyzi.push_back(v);
            rings.push_back(float(p.ring));
            times.push_back(float(p.time_s));
        }
        const fs::path file = fs::path(testing::TempDir()) / "points.npz";
        write_npz(file, {make_array("points", {points.size(), 4}, xyzi.data(), xyzi.size()),
                         make_array("ring", {points.size()}, rings.data(), rings.size()),
                         make_array("time", {points.size()}, times.data(), times.size())});
        return test::read_text(file);
    };
    const PointLog files("npz_points", "npz", npz, R"(, "point_times": "absolute")");
    expect_street(files, 1e-6);
    const float number = 1.0f;
    for (const fs::path& file : fs::directory_iterator(files.folder / "scans"))
        write_npz(file, {make_array("depth", {1}, &number, 1)});
    EXPECT_THAT(
        test::find_load_error(files.folder.string()),
        testing::AllOf(test::Names("depth ... 'points'"), testing::Not(testing::HasSubstr("skip_broken"))));
    const std::vector<float> six(60, 1.0f);
    for (const fs::path& file : fs::directory_iterator(files.folder / "scans"))
        write_npz(file, {make_array("points", {10, 6}, six.data(), six.size())});
    EXPECT_THAT(test::find_load_error(files.folder.string()),
                testing::AllOf(test::Names("dimension ... 6 ... \"columns\" ... sequence.json"),
                               testing::Not(testing::HasSubstr("skip_broken"))));
}

TEST(OtherPrograms, Float32TimesAndNegativeIntensities) {
    const auto bytes_of = [](const test::FilePoints& points) {
        std::string bytes;
        for (const test::FilePoint& p : points)
            for (const float v : {p.point_m.x, p.point_m.y, p.point_m.z, p.ring == 3 ? -0.25f : 0.5f,
                                  float(p.ring), float(1.7e9 + p.time_s)})
                bytes.append(reinterpret_cast<const char*>(&v), sizeof v);
        return bytes;
    };
    const PointLog files("float_times", "bin", bytes_of,
                         R"(, "columns": ["x", "y", "z", "intensity", "ring", "time"], "intensity_max": 1,
                           "point_times": "absolute")");
    const Log log = files.load();
    for (const char* note : {"precision", "azimuths", "-0.25"})
        EXPECT_THAT(log.notes, testing::Contains(test::Names(note)));
}

/// Checks that a ray of each log has the same time after the first ray of its scan.
void expect_times_after_first(const Log& log, const Log& street) {
    for (std::size_t f = 0; f < street.frames.size(); ++f) {
        const Scan &scan = log.frames[f].scan, &truth = street.frames[f].scan;
        ASSERT_EQ(scan.range_m.size(), truth.range_m.size());
        float first_s = INFINITY;
        for (std::size_t i = 0; i < truth.range_m.size(); ++i)
            if (truth.range_m[i] > 0.0f) first_s = std::min(first_s, truth.rays.time_offset_s[i]);
        for (std::size_t i = 0; i < truth.range_m.size(); ++i)
            if (truth.range_m[i] > 0.0f) {
                ASSERT_NEAR(scan.rays.time_offset_s[i], truth.rays.time_offset_s[i] - first_s, 1e-6) << i;
            }
    }
}

TEST(OtherPrograms, NanosecondsAfterTheFirstPointOfOuster) {
    const auto ply = [](const test::FilePoints& points) {
        std::string bytes = fmt::format(
            "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
            "property float z\nproperty float intensity\nproperty ushort ring\nproperty uint t\nend_header\n",
            points.size());
        const auto append = [&](const auto& value) {
            bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
        };
        const double first_s = std::ranges::min(points, {}, &test::FilePoint::time_s).time_s;
        for (const test::FilePoint& p : points) {
            append(p.point_m);
            append(p.intensity);
            append(p.ring);
            append(std::uint32_t(std::lround(1e9 * (p.time_s - first_s))));
        }
        return bytes;
    };
    const PointLog files("ouster_ply", "ply", ply, "");
    const Log log = files.load();
    expect_times_after_first(log, files.street);
    const auto unit = std::ranges::find(log.conventions_used, "unit of point times", &UsedConvention::name);
    ASSERT_NE(unit, log.conventions_used.end());
    EXPECT_EQ(unit->value, "ns");
    EXPECT_THAT(unit->from, testing::StartsWith("guess: "));
    files.put_head(R"(, "time_unit": "us")");
    EXPECT_THAT(test::find_load_error(files.folder.string()), test::Names("time ... conventions.time_unit"));
}

TEST(OtherPrograms, NanosecondsSince1970) {
    const auto npy = [](test::FilePoints points) {
        for (test::FilePoint& p : points) p.time_s = 1e9 * (1.7e9 + p.time_s);
        return test::npy(points);
    };
    const PointLog files("unix_ns", "npy", npy,
                         R"(, "columns": ["x", "y", "z", "intensity", "ring", "timestamp"])");
    expect_times_after_first(files.load(), files.street);
}

TEST(OtherPrograms, IgnoresUselessTimesOfSustechpoints) {
    const auto pcd = [](test::FilePoints points) {
        std::mt19937_64 random(5);
        for (test::FilePoint& p : points) p.time_s = std::bit_cast<double>(random());
        return test::make_pcd_binary(points);
    };
    const Log log = PointLog("sustech", "pcd", pcd, R"(, "intensity_max": 255)").load();
    EXPECT_EQ(log.lidars[0].sensor.beams.size(), 16u);
    EXPECT_THAT(log.notes, testing::Contains(test::Names("times of points are ignored")));
}

TEST(OtherPrograms, PointsOfWrongTimeAreSkipped) {
    const auto late = [](test::FilePoints points) {
        for (std::size_t i = 0; i < 20; ++i) points[i].time_s += i % 2 == 0 ? 0.7 : 4.288;
        return test::make_pcd_binary(points);
    };
    const PointLog files("late_points", "pcd", late, kStamped);
    const Log log = files.load();
    EXPECT_THAT(log.notes, testing::Contains(test::Names("80 points ... 4")));
    for (const Frame& frame : log.frames)
        for (const float t_s : frame.scan.rays.time_offset_s) EXPECT_LT(std::abs(t_s), 0.06f);
}

TEST(OtherPrograms, NamesThePackedPointsOfNclt) {
    const auto nclt = [](const test::FilePoints& points) {
        std::string bytes;
        for (const test::FilePoint& p : points) {
            for (int axis = 0; axis < 3; ++axis) {
                const auto packed = std::uint16_t((p.point_m[axis] + 100.0f) / 0.005f);
                bytes.append(reinterpret_cast<const char*>(&packed), sizeof packed);
            }
            bytes += char(std::lround(255.0f * p.intensity));
            bytes += char(p.ring);
        }
        return bytes;
    };
    const PointLog files("nclt", "bin", nclt, "");
    EXPECT_THAT(test::find_load_error(files.folder.string()), test::Names("NCLT ... uint16 ... laser"));
}

TEST(OtherPrograms, FindsTheSensorOfPointsInAnotherFrame) {
    const PointLog files("body_frame", "bin", test::bin, kRings);
    const auto expect_note = [&](const Pose& body_from_sensor, const std::string& parts) {
        for (std::size_t i = 0; i < files.street.frames.size(); ++i)
            files.change_points(i, [&](test::FilePoint& p) {
                p.point_m = glm::vec3(body_from_sensor * glm::dvec3(p.point_m));
            });
        EXPECT_THAT(files.load().notes, testing::Contains(test::Names(parts)));
    };
    // NCLT stores points in the frame of the body, 0.957 m below the Velodyne.
    expect_note({make_rotation(1.58, 0.0, 0.05), {0.002, -0.004, 0.957}},
                "elevation ... (0.00, 0.00, 0.96) m ... 2.9 degrees ... vehicle_from_sensor");
    expect_note({make_rotation(0.3, -0.06, 0.0), {1.25, -0.4, 2.5}},
                "elevation ... (1.25, -0.40, 2.50) m ... 3.4 degrees");
}

}  // namespace
}  // namespace relidar
