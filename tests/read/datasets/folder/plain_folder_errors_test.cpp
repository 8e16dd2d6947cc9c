// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include <fmt/format.h>

#include "read/datasets/kitti/kitti_drive.hpp"
#include "read/files/point_writers.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::replace_first;

/// Two scans of a cylinder (16 beams x 90 columns) as PCD, which the tests damage.
class FolderDamage : public testing::Test {
protected:
    void SetUp() override {
        folder = fs::path(testing::TempDir()) / "relidar_folder_damage";
        fs::remove_all(folder);
        put("scans/a.pcd", test::make_pcd_binary(points));
        put("scans/b.pcd", test::make_pcd_compressed(points));
        put("sequence.json", head);
        put("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n");
        put("boxes.json",
            R"({"boxes": [{"track": "a", "category": "Car", "time_s": 0, "size": [4, 2, 1], "position": [5, 0, 0], "yaw_deg": 0}]})");
    }
    void put(const std::string& name, const std::string& text) const {
        test::write_text(folder / name, text);
    }

    /// Returns the error of loading the folder while a file has another text or is
    /// missing.
    std::string complaint(const std::string& name, const std::string& text,
                          const DatasetOptions& options = {}) const {
        const std::string good = fs::exists(folder / name) ? test::read_text(folder / name) : "";
        text == kMissing ? void(fs::remove(folder / name)) : put(name, text);
        const std::string said = test::find_load_error("folder:" + folder.string(), options);
        good.empty() ? void(fs::remove(folder / name)) : put(name, good);
        return said;
    }
    void expect(const std::string& name, const std::string& text, const std::string& parts,
                const DatasetOptions& options = {}) const {
        EXPECT_THAT(complaint(name, text, options), test::Names(parts));
    }
    void expect_head(const std::string& text, const std::string& parts,
                     const DatasetOptions& options = {}) const {
        expect("sequence.json", text, parts, options);
    }
    Log load(const DatasetOptions& options = {}) const {
        return load_log("folder:" + folder.string(), options);
    }
    std::string load_notes() const { return test::join_lines(load().notes); }
    std::string with(const std::string& members) const {
        return head.substr(0, head.size() - 1) + ", " + members + "}";
    }
    std::string with_lidar(const std::string& members) const {
        return with(R"("lidars": [{)" + members + "}]");
    }

    static constexpr const char* kMissing = "(missing)";
    const std::string head =
        R"({"format": "relidar log", "version": 1, "rate_hz": 10, "intensity_max": 255, "point_times": "absolute"})";
    fs::path folder;
    test::FilePoints points = test::make_cylinder(90);
};

TEST_F(FolderDamage, IsNoneToBeginWith) {
    for (test::FilePoint& p : points) p.time_s = 0.1;
    put("scans/b.pcd", test::make_pcd_compressed(points));
    EXPECT_EQ(complaint("notes.txt", ""), "nothing");
}

TEST_F(FolderDamage, OfTheHead) {
    expect_head(kMissing, "sequence.json: no such file");
    expect_head("", "sequence.json ... JSON");
    expect_head(head.substr(0, 40), "sequence.json ... JSON");
    expect_head("[]", "object");
    expect_head("{}", "format ... missing");
    expect_head(replace_first(head, "relidar log", "relidar"), R"(format ... "relidar log")");
    expect_head(replace_first(head, "1,", "2,"), "version: found 2");
    expect_head(with(R"("intensity_maks": 1)"), "'intensity_maks' ... format ... version");
    expect_head(with(R"("frames": [])"), R"(both "frames" and "rate_hz")");
    expect_head(replace_first(head, R"("rate_hz": 10, )", ""), R"(neither "frames" nor "rate_hz")");
    expect_head(replace_first(head, "10", "0"), "rate_hz: found 0");
    expect_head(with(R"("time_unit": "sec")"), R"(time_unit ... "sec" ... s, ms, us, ns)");
    expect_head(with(R"("start_unix_ns": -1)"), "start_unix_ns: found -1");
    expect_head(with(R"("labelled_azimuth_rad": [0.5, -0.5])"), "labelled_azimuth_rad: found another order");
    expect_head(with(R"("lidars": [])"), "lidars ... LiDAR");
    expect_head(with_lidar(R"("sensor": "VLP-61")"), "VLP-16");
    expect_head(with_lidar(R"("sensor": "missing.csv")"), "missing.csv");
    expect_head(with_lidar(R"("scans": "nowhere")"), "nowhere: no such folder");
    expect_head(with_lidar(R"("sensor": {"beams": [], "columns": 8})"), "beams: found 0 beams");
    expect_head(with_lidar(R"("sensor": {"beams": [{"elevation_deg": 1}]})"), "columns ... missing");
    expect_head(
        with_lidar(R"("sensor": {"beams": [{"elevation_deg": 1}, {"elevation_deg": 2}], "columns": 8})"),
        "lowest");
    expect_head(with_lidar(R"("spins": false, "sensor": {"beams": [{"elevation_deg": 1}], "columns": 8})"),
                "spins ... false ... beams");
    expect_head(with_lidar(R"("vehicle_from_sensor": [2,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1])"),
                "vehicle_from_sensor ... rotation");
    expect_head(with_lidar(R"("vehicle_from_sensor": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,1,1])"),
                "vehicle_from_sensor ... last row 0 0 1 1 ... transposed");
    expect_head(with_lidar(R"("vehicle_from_sensor": {"translation": [0,0,0], "quaternion": [0,0,0,0]})"),
                "quaternion ... 0");
    expect_head(with(R"("lidars": [{"name": "a"}, {"name": "a", "scans": "scans"}])"),
                "scans/a: no such folder");
}

TEST_F(FolderDamage, OfListedFrames) {
    const auto frames = [&](const std::string& list) {
        return replace_first(head, R"("rate_hz": 10)", R"("frames": [)" + list + "]");
    };
    const std::string a = R"({"number": 0, "time_s": 0, "scan": "scans/a.pcd"})";
    expect_head(frames(""), "frames ... frame");
    expect_head(frames(R"({"number": 0, "scan": "scans/a.pcd"})"), "frames[0].time_s ... missing");
    expect_head(frames(R"({"number": -1, "time_s": 0, "scan": "scans/a.pcd"})"),
                "frames[0].number: found -1");
    expect_head(frames(a + R"(, {"number": 1, "time_s": 0, "scan": "scans/a.pcd"})"),
                "frame 1 ... 0 s ... frame 0 ... 0 s");
    expect_head(frames(R"({"number": 0, "time_s": 0, "scan": "scans/a.pcd", "lidar": "x"})"),
                R"("x" ... name)");
    expect_head(frames(R"({"number": 0, "time_s": 0, "scan": "scans/a.txt"})"),
                "relidar_folder_damage ... 1 scans ... missing");
    expect_head(frames(R"({"number": 0, "time_s": 0, "scan": "scans/x.pcd"})"),
                "x.pcd: no such file ... frame 0", {.allow_missing_scans = false});
    EXPECT_THAT(complaint("notes.txt", "", {.frames = {7, 9}}), test::Names("frames 7:9"));
}

TEST_F(FolderDamage, OfPosesAndBoxes) {
    expect("poses.txt", kMissing, "poses.txt ... dataset.poses=FILE");
    expect("poses.txt", "", "poses.txt ... pose");
    expect("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", "poses.txt ... 1 ... frame 1 ... line 2");
    expect("poses.txt", "1 2 3\n", "poses.txt line 1 ... '1 2 3' ... 8");
    expect("poses.txt", "0 0 0 0 1 0 0 0\n0 0 0 0 1 0 0 0\n",
           "poses.txt line 2 ... 0 s ... 0 s ... increasing");
    expect("poses.txt", "0 0 0 nan 1 0 0 0\n", "finite");
    expect("poses.txt", "0 0 0 0 0.5 0 0 0\n", "quaternion ... 0.5");
    expect("poses.txt", "5 0 0 0 1 0 0 0\n6 0 0 0 1 0 0 0\n", "5 ... 6 s ... frame 0 ... 0 s");
    expect("poses.txt", "# time_s x y z qw qx qy yaw\n0 0 0 0 1 0 0 0\n",
           "poses.txt line 1: column 'yaw' ... unknown");
    // seconds since 1970 for a folder with "rate_hz", and two wrong units
    expect("poses.txt", "1700000005 0 0 0 1 0 0 0\n1700000006 0 0 0 1 0 0 0\n",
           R"(frame 0 ... 0 s ... "frames" ... "rate_hz")");
    expect("poses.txt", "1700000005000000000 0 0 0 1 0 0 0\n", "line 1 ... seconds");
    put("poses.txt", "0 0 0 0 1 0 0 0\n0.1 0 0 0 1 0 0 0\n");
    expect_head(replace_first(head, "10", "0.01"), "frames seem to be in milliseconds");
    put("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n");
    expect("poses.txt", "time_s x y z qw qx qy\n", "poses.txt line 1 ... 'qz' ... missing");
    const std::string good = test::read_text(folder / "boxes.json");
    expect("boxes.json", good.substr(0, 30), "boxes.json ... JSON");
    expect("boxes.json", replace_first(good, R"("yaw_deg": 0)", R"("yaw": 0)"),
           "boxes[0] ... 'yaw' ... time_s");
    expect("boxes.json",
           replace_first(good, R"("yaw_deg": 0)", R"("yaw_deg": 0, "quaternion": [1, 0, 0, 0])"),
           R"(boxes[0] ... "yaw_deg" ... "quaternion")");
    expect("boxes.json", replace_first(good, "[4, 2, 1]", "[4, 2, 0]"), "box 'a' ... size 4 x 2 x 0 m");
    expect("boxes.json", replace_first(good, R"("time_s": 0)", R"("frame": 9)"), "9 ... frame");
}

TEST_F(FolderDamage, OfPointFiles) {
    const std::string good = test::make_pcd_binary(points);
    expect("scans/a.pcd", "", "a.pcd ... DATA ... missing");
    expect("scans/a.pcd", good.substr(0, good.size() - 1), "a.pcd ... truncated");
    expect("scans/a.pcd", replace_first(good, "POINTS 1440", "POINTS 999999999"),
           "a.pcd ... 999999999 ... 1");
    expect("scans/a.pcd", replace_first(good, "POINTS 1440", "POINTS 0"), "a.pcd ... 0 points");
    expect("scans/a.pcd", replace_first(good, "POINTS 1440", "POINTS -3"), "POINTS '-3' ... whole");
    expect("scans/a.pcd", replace_first(good, "SIZE 4 4 4", "SIZE 4 4"), "7 FIELDS, 6 SIZE");
    expect("scans/a.pcd", replace_first(good, "SIZE 4 4 4", "SIZE 3 4 4"), "'x' ... F3");
    expect("scans/a.pcd", replace_first(good, "COUNT 1", "COUNT 0"), "COUNT ... 'x' ... 0");
    expect("scans/a.pcd", replace_first(good, "FIELDS x y z", "FIELDS x y y"), "field 'y' ... twice");
    expect("scans/a.pcd", replace_first(good, "FIELDS x y z", "FIELDS x y w"), "field z");
    expect("scans/a.pcd", replace_first(good, "DATA binary", "DATA packed"), "DATA 'packed'");
    const std::string packed = test::make_pcd_compressed(points);
    expect("scans/b.pcd", packed.substr(0, packed.size() - 5), "compressed");
    std::string other = packed;
    for (std::size_t at = other.size() - 40; at < other.size(); ++at) other[at] = char(0xFF);
    expect("scans/b.pcd", other, "damaged");
    const std::string text = test::make_pcd_text(points);
    expect("scans/a.pcd", text.substr(0, text.size() / 2), "a.pcd ... point ... 9");
    const std::string ply = test::make_ply_binary(points);
    fs::remove(folder / "scans/a.pcd");
    expect("scans/a.ply", ply.substr(0, ply.size() - 1), "a.ply ... truncated");
    expect("scans/a.ply", replace_first(ply, "binary_little_endian", "binary_big_endian"),
           "format 'binary_big_endian'");
    expect("scans/a.ply", replace_first(ply, "element vertex", "element camera"),
           "'element vertex N' ... first");
    expect("scans/a.ply", replace_first(ply, "property ushort", "property list ushort"),
           "'ushort' ... 'list'");
    expect("scans/a.bin", std::string(15, 'x'), "a.bin ... 15 ... 16");
    expect("scans/a.bin", "", "a.bin ... 0 points");
    expect("scans/a.npy", test::npy(points), "a.npy ... 2 ... 6 ... [points, 4]");
    expect("scans/a.npy", "x", "a.npy");
    expect("scans/a.npz", "x", "a.npz");
}

/// Clouds of relidar state whether their points are deskewed.
TEST_F(FolderDamage, OfDeskewedPoints) {
    for (const char* frame :
         {"points_in world: the dataset's own", "points_in sensor at time_s: x forward, y left, z up"}) {
        const std::string pcd = fmt::format("# {}\n", frame) + test::make_pcd_binary(points);
        const std::string ply =
            replace_first(test::make_ply_binary(points), "ply\n", fmt::format("ply\ncomment {}\n", frame));
        expect("scans/a.pcd", pcd, "a.pcd ... motion-compensated");
        fs::rename(folder / "scans/a.pcd", folder / "a.pcd");
        expect("scans/a.ply", ply, "a.ply ... motion-compensated");
        fs::rename(folder / "a.pcd", folder / "scans/a.pcd");
        put("sequence.json", with(R"("motion_compensated": true)"));
        EXPECT_EQ(complaint("scans/a.pcd", pcd, {.poses_file = kNoPoses}), "nothing");
        put("sequence.json", head);
    }
    expect("scans/a.pcd", "# points_in sensor at each ray's firing time\n" + test::make_pcd_binary(points),
           "nothing");
}

/// The two scans are 0.1 s apart. The points of a scan were measured within 0.09 s.
TEST_F(FolderDamage, TimesInWrongUnitAreNoted) {
    const auto notes_of = [&](double unit_s) {
        for (int scan = 0; scan < 2; ++scan) {
            for (std::size_t i = 0; i < points.size(); ++i)
                points[i].time_s = (0.1 * scan + 0.001 * double(i % 90)) / unit_s;
            put(scan == 0 ? "scans/a.pcd" : "scans/b.pcd", test::make_pcd_binary(points));
        }
        return load_notes();
    };
    EXPECT_THAT(notes_of(1.0), testing::Not(test::Names("span")));
    EXPECT_THAT(notes_of(1000.0), test::Names("span ... 0.1 s"));
    EXPECT_THAT(notes_of(1e60), test::Names("span 0 s")) << "all times are equal";
    // The times have the right unit, but a different zero than the scans.
    notes_of(1.0);
    for (test::FilePoint& point : points) point.time_s += 5.0;
    put("scans/a.pcd", test::make_pcd_binary(points));
    put("scans/b.pcd", test::make_pcd_binary(points));
    EXPECT_THAT(load_notes(), test::Names("times ... 5"));
}

TEST_F(FolderDamage, PosesMayBeSeparatedByCommas) {
    const auto load_poses = [&](const std::string& text) {
        put("poses.txt", text);
        return load().world_from_vehicle.pose;
    };
    const std::string values = "0 1 2 3 1 0 0 0\n0.1 2 2 3 1 0 0 0\n";
    const std::vector<Pose> expected = load_poses(values);
    for (const std::string header : {"", "timestamp,tx,ty,tz,qw,qx,qy,qz\n"}) {
        std::string text = values;
        std::ranges::replace(text, ' ', ',');
        const std::vector<Pose> poses = load_poses(header + text);
        ASSERT_EQ(poses.size(), expected.size());
        for (std::size_t i = 0; i < poses.size(); ++i)
            EXPECT_EQ(poses[i].translation, expected[i].translation) << header;
    }
}

TEST_F(FolderDamage, PoseTimesInWrongUnitAreNoted) {
    const auto notes_of = [&](double step_s, const char* header = "") {
        put("poses.txt", header + fmt::format("0 0 0 0 1 0 0 0\n{} 1 0 0 1 0 0 0\n{} 2 0 0 1 0 0 0\n", step_s,
                                              2.0 * step_s));
        return load_notes();
    };
    EXPECT_THAT(notes_of(0.1), testing::Not(test::Names("apart")));
    for (const char* header : {"", "# time_s x y z qw qx qy qz\n"})
        EXPECT_THAT(notes_of(100.0, header), test::Names("100 s apart ... 0.1 s"));
}

TEST_F(FolderDamage, DamagedPosesThatAreNotUsedAreNoError) {
    put("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n");
    const Log files = load({.poses_file = kNoPoses});
    EXPECT_EQ(files.frames.size(), 2u);
    EXPECT_THAT(test::join_lines(files.notes), test::Names("poses.txt ... 1 ... boxes"));
}

TEST_F(FolderDamage, FilesBesideTheScans) {
    put("scans/._a.pcd", "a file of another operating system");
    EXPECT_EQ(load().frames.size(), 2u);
    expect("scans/a.ply", test::make_ply_binary(points), "a.ply ... a.pcd");
}

TEST_F(FolderDamage, MissingScansAreNoted) {
    const auto notes_of = [&](const std::vector<int>& numbers) {
        fs::remove_all(folder / "scans");
        fs::create_directories(folder / "scans");
        std::string poses;
        for (const int number : numbers) {
            put(fmt::format("scans/{:06}.pcd", number), test::make_pcd_binary(points));
            poses += "1 0 0 0 0 1 0 0 0 0 1 0\n";
        }
        put("poses.txt", poses);
        return load_notes();
    };
    EXPECT_THAT(notes_of({0, 1, 3}), test::Names("between 000001 ... 000003"));
    EXPECT_THAT(notes_of({0, 2, 3}), test::Names("between 000000 ... 000002"));
    EXPECT_THAT(notes_of({0, 5, 10}), testing::Not(test::Names("between")));
    EXPECT_THAT(notes_of({100, 199, 301}), testing::Not(test::Names("between")));
}

TEST_F(FolderDamage, OfValues) {
    const auto changed = [&](auto change) {
        test::FilePoints some = points;
        change(some[7]);
        return test::make_pcd_binary(some);
    };
    expect("scans/a.pcd", changed([](auto& p) { p.point_m.y = 1e7f; }), "a.pcd: point 7 ... (");
    expect("scans/a.pcd", changed([](auto& p) { p.time_s = NAN; }), "a.pcd: point 7 ... time nan");
    expect("scans/a.pcd", changed([](auto& p) { p.time_s = 1e9; }),
           "conventions.time_unit ... conventions.time_zero");
    expect("scans/a.pcd", changed([](auto& p) { p.ring = 65535; }), "a.pcd: point 7 ... ring ... 65535");
    expect_head(replace_first(head, R"("intensity_max": 255, )", ""),
                R"(intensity ... 51 ... 0 to 1 ... "intensity_max")");
    expect("sequence.json",
           with(R"("lidars": [{"sensor": {"beams": [{"elevation_deg": 1}], "columns": 8}}])"), "1 beams");
    for (test::FilePoint& p : points) {
        p.ring = 0;
        p.point_m = {5.0f, 0.0f, 0.0f};
    }
    expect("scans/a.pcd", test::make_pcd_binary(points), R"("spins" ... sequence.json)");
}

}  // namespace
}  // namespace relidar
