// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include <regex>

#include <fmt/ranges.h>

#include <relidar/base/arrays.hpp>
#include <relidar/base/files.hpp>
#include "read/datasets/folder/point_log.hpp"
#include "support/rig_street.hpp"
#include "support/two_lidars.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::expect_street;
using test::kStamped;
using test::make_fresh_folder_path;
using test::PointLog;

Log make_rich_street() {
    Log street = test::make_two_lidar_street({.n_frames = 5, .rows = 16, .columns = 256});
    test::add_second_returns(street, 7, 2.5f, 77.0f);
    street.notes = {"a first note", {"speed", -1, "found again by each load"}, "a second one"};
    street.world_offset_m += glm::dvec3(457123.4, 5428765.3, 112.9);  // map coordinates
    street.labelled_azimuth = {-0.7, 0.6};
    street.georeference = {{49.01, 8.42, 112.9}, {457123.4, 5428765.3, 112.9}, "EPSG:32632"};
    return street;
}

void expect_same_poses(const PoseTrack& log, const PoseTrack& truth, double tolerance_m) {
    EXPECT_EQ(log.time_s, truth.time_s);
    ASSERT_EQ(log.pose.size(), truth.pose.size());
    for (std::size_t k = 0; k < truth.pose.size(); ++k) {
        EXPECT_LT(glm::distance(log.pose[k].translation, truth.pose[k].translation), tolerance_m);
        EXPECT_NEAR(std::abs(glm::dot(log.pose[k].rotation, truth.pose[k].rotation)), 1.0, 1e-12);
    }
}

void expect_same_log(const Log& log, const Log& truth) {
    EXPECT_EQ(log.name, truth.name);
    EXPECT_EQ(log.conventions, truth.conventions);
    EXPECT_EQ(log.start_unix_ns, truth.start_unix_ns);
    EXPECT_EQ(log.labelled_azimuth, truth.labelled_azimuth);
    const auto list_saved_notes = [](Notes notes) {
        std::erase_if(notes, [](const Note& note) { return !note.id.empty(); });
        return notes;
    };
    EXPECT_EQ(list_saved_notes(log.notes), list_saved_notes(truth.notes));
    EXPECT_EQ(log.rolling_shutter, truth.rolling_shutter);
    EXPECT_EQ(log.world_offset_m, truth.world_offset_m);
    ASSERT_EQ(log.georeference.has_value(), truth.georeference.has_value());
    if (truth.georeference) {
        EXPECT_EQ(log.georeference->point_m, truth.georeference->point_m);
    }
    // The positions are 5000 km from the origin, so the tolerance is the last digit.
    expect_same_poses(log.world_from_vehicle, truth.world_from_vehicle, 2e-9);
    ASSERT_EQ(log.lidars.size(), truth.lidars.size());
    for (std::size_t l = 0; l < truth.lidars.size(); ++l) {
        EXPECT_EQ(log.lidars[l].name, truth.lidars[l].name);
        EXPECT_EQ(log.lidars[l].vehicle_from_sensor.translation,
                  truth.lidars[l].vehicle_from_sensor.translation);
        EXPECT_EQ(log.lidars[l].vehicle_from_sensor.rotation, truth.lidars[l].vehicle_from_sensor.rotation);
        const SpinningSensor &a = log.lidars[l].sensor, &b = truth.lidars[l].sensor;
        EXPECT_EQ(a.name, b.name);
        EXPECT_EQ(
            std::tuple(a.columns, a.period_s, a.clockwise, a.min_range_m, a.max_range_m, a.divergence_rad),
            std::tuple(b.columns, b.period_s, b.clockwise, b.min_range_m, b.max_range_m, b.divergence_rad));
        EXPECT_NEAR(a.first_azimuth_rad, b.first_azimuth_rad, 1e-14);
        ASSERT_EQ(a.beams.size(), b.beams.size());
        for (std::size_t k = 0; k < b.beams.size(); ++k) {
            EXPECT_NEAR(a.beams[k].elevation_rad, b.beams[k].elevation_rad, 1e-14);
            EXPECT_NEAR(a.beams[k].azimuth_offset_rad, b.beams[k].azimuth_offset_rad, 1e-14);
            EXPECT_EQ(
                std::tuple(a.beams[k].origin_offset_m, a.beams[k].origin_up_m, a.beams[k].origin_left_m),
                std::tuple(b.beams[k].origin_offset_m, b.beams[k].origin_up_m, b.beams[k].origin_left_m));
        }
    }
    ASSERT_EQ(log.boxes.size(), truth.boxes.size());
    for (std::size_t k = 0; k < truth.boxes.size(); ++k) {
        EXPECT_EQ(log.boxes[k].id, truth.boxes[k].id);
        EXPECT_EQ(log.boxes[k].category, truth.boxes[k].category);
        EXPECT_EQ(log.boxes[k].size_m, truth.boxes[k].size_m);
        expect_same_poses(log.boxes[k].world_from_box, truth.boxes[k].world_from_box, 2e-9);
    }
}

void expect_same_scans(const Log& log, const Log& truth) {
    ASSERT_EQ(log.frames.size(), truth.frames.size());
    for (std::size_t i = 0; i < truth.frames.size(); ++i) {
        const Frame &a = log.frames[i], &b = truth.frames[i];
        EXPECT_EQ(std::tuple(a.index, a.time_s, a.lidar), std::tuple(b.index, b.time_s, b.lidar));
        EXPECT_EQ(std::tuple(a.scan.rays.rows, a.scan.rays.columns, a.scan.rays.divergence_rad),
                  std::tuple(b.scan.rays.rows, b.scan.rays.columns, b.scan.rays.divergence_rad));
        EXPECT_TRUE(a.scan.rays.ray_divergence_rad == b.scan.rays.ray_divergence_rad) << "frame " << i;
        EXPECT_TRUE(a.scan.range_m == b.scan.range_m && a.scan.intensity == b.scan.intensity)
            << "frame " << i;
        EXPECT_TRUE(a.scan.rays.origin == b.scan.rays.origin &&
                    a.scan.rays.direction == b.scan.rays.direction)
            << "frame " << i;
        EXPECT_TRUE(a.scan.rays.time_offset_s == b.scan.rays.time_offset_s &&
                    a.scan.rays.channel == b.scan.rays.channel)
            << "frame " << i;
        EXPECT_EQ(a.scan.classes, b.scan.classes);
        ASSERT_EQ(a.scan.second_returns.size(), b.scan.second_returns.size());
        for (std::size_t k = 0; k < b.scan.second_returns.size(); ++k)
            EXPECT_TRUE(a.scan.second_returns[k].range_m == b.scan.second_returns[k].range_m &&
                        a.scan.second_returns[k].intensity == b.scan.second_returns[k].intensity);
    }
}

fs::path save(const std::string& name, const Log& files) {
    const fs::path folder = make_fresh_folder_path(name);
    save_folder(files, folder);
    return folder;
}

TEST(SaveFolder, IsReadAsTheSameLog) {
    const Log street = make_rich_street();
    ASSERT_FALSE(street.boxes.empty());
    const fs::path folder = save("saved", street);
    EXPECT_EQ(detect_kind(folder), "folder");
    const Log log = load_log(folder.string(), {});
    expect_same_log(log, street);
    expect_same_scans(log, street);
}

TEST(SaveFolder, KeepsADrive) {
    const Log truth = test::KittiDrive("to_folder").load();
    const Log log = load_log(save("drive", truth).string(), {});
    expect_same_log(log, truth);
    expect_same_scans(log, truth);
}

TEST(SaveFolder, KeepsRaysOfASensorThatDoesNotSpin) {
    Log street = make_street_log({.n_frames = 3, .rows = 8, .columns = 64});
    street.lidars[0].sensor = {
        .name = "flash", .beams = {}, .columns = 0, .period_s = 0.0, .max_range_m = 60.0};
    const fs::path folder = save("flash", street);
    const Log log = load_log(folder.string(), {});
    EXPECT_EQ(log.lidars[0].sensor.period_s, 0.0);
    EXPECT_EQ(log.lidars[0].sensor.max_range_m, 60.0);
    for (Frame& frame : street.frames) limit_ranges(frame.scan, {0.0, 60.0});
    expect_same_scans(log, street);
}

TEST(SaveFolder, KeepsARigOfSensorsThatDoNotSpin) {
    StreetOptions options{.n_frames = 2};
    options.rig = test::write_rig(fs::path(testing::TempDir()) / "relidar_folder_rig");
    Log street = make_street_log(options);
    RayTable table = make_lidar_rays(street.lidars[test::kRosette], 0.4);
    for (std::size_t i = 0; i < table.size(); ++i) table.ray_divergence_rad.push_back(1e-3f * float(i % 7));
    for (Frame& frame : street.frames)
        if (frame.lidar == test::kRosette) frame.scan.rays.ray_divergence_rad = table.ray_divergence_rad;
    street.lidars[test::kRosette].pattern = table;
    const fs::path folder = save("rig", street);
    const Log log = load_log(folder.string(), {});
    ASSERT_EQ(log.lidars.size(), 4u);
    EXPECT_FALSE(log.lidars[test::kSpinning].pattern);
    for (const int l : {test::kWindow, test::kRosette, test::kTwoReturns}) {
        const RayTable a = make_lidar_rays(log.lidars[std::size_t(l)], 0.7),
                       b = make_lidar_rays(street.lidars[std::size_t(l)], 0.7);
        ASSERT_EQ(a.size(), b.size());
        for (std::size_t i = 0; i < a.size(); ++i)
            ASSERT_LT(glm::distance(a.direction[i], b.direction[i]), 2e-7f);
        EXPECT_EQ(a.time_offset_s, b.time_offset_s);
        EXPECT_FLOAT_EQ(a.divergence_rad, b.divergence_rad);
        EXPECT_EQ(a.ray_divergence_rad, b.ray_divergence_rad);
        EXPECT_EQ(log.lidars[std::size_t(l)].sensor.max_range_m,
                  street.lidars[std::size_t(l)].sensor.max_range_m);
    }
    expect_same_scans(log, street);
}

TEST(SaveFolder, SaysThatScansAreMotionCompensated) {
    Log street = make_street_log({.n_frames = 3, .rows = 8, .columns = 64});
    street.rolling_shutter = false;
    const fs::path folder = save("compensated_log", street);
    const std::vector<NamedArray> arrays = read_npz((folder / "scans/000001.npz").string());
    EXPECT_EQ(find_array(arrays, "deskewed")->to_floats(), std::vector<float>{1.0f});
    EXPECT_EQ(find_array(arrays, "time")->to_floats(), std::vector<float>(8 * 64, 0.0f));
    const Log log = load_log(folder.string(), {});
    EXPECT_FALSE(log.rolling_shutter);
    EXPECT_FALSE(log.frames[1].start);
    for (std::size_t i = 0; i < 8 * 64; ++i) {
        const auto loaded_return = locate_return(log, log.frames[1], i),
                   truth = locate_return(street, street.frames[1], i);
        ASSERT_LT(glm::distance(loaded_return.point_m, truth.point_m), 1e-6) << i;
    }
    const std::regex statement("\"motion_compensated\": true");
    const std::string head = test::read_text(folder / "sequence.json");
    test::write_text(folder / "sequence.json",
                     std::regex_replace(head, statement, "\"motion_compensated\": false"));
    EXPECT_THROW(load_log(folder.string(), {}), DataError) << "each scan says it too";
}

TEST(SaveFolder, ReadsARangeOfItsFrames) {
    const Log street = make_rich_street();
    const fs::path folder = save("range", street);
    const Log log = load_log(folder.string(), {.frames = {1, 3}});
    ASSERT_EQ(log.frames.size(), 4u);
    EXPECT_EQ(log.frames[0].scan.range_m, street.frames[2].scan.range_m);
    for (const BoxTrack& box : log.boxes)
        EXPECT_TRUE(log.world_from_vehicle.contains_time(box.world_from_box.time_s.front())) << box.id;
}

std::vector<std::string> list_names_in(const fs::path& folder) {
    std::vector<std::string> names;
    for (const auto& entry : fs::directory_iterator(folder)) names.push_back(entry.path().filename());
    return names;
}

TEST(SaveFolder, ReadsAFewScansForALook) {
    const Log street = make_rich_street();  // five frames of each LiDAR
    const fs::path folder = save("looked_at", street);
    const Log log = load_log(folder.string(), {.max_scans = 2});
    expect_same_log(log, street);
    ASSERT_EQ(log.frames.size(), street.frames.size());
    for (std::size_t i = 0; i < street.frames.size(); ++i) {
        const int of_its_lidar = int(i) / 2;
        EXPECT_EQ(log.frames[i].time_s, street.frames[i].time_s);
        if (of_its_lidar == 0 || of_its_lidar == 2)
            EXPECT_TRUE(log.frames[i].scan.range_m == street.frames[i].scan.range_m) << i;
        else EXPECT_TRUE(log.frames[i].scan.range_m.empty()) << i;
    }
}

TEST(SaveFolder, LeavesNothingUnfinished) {
    const Log street = make_rich_street();
    const fs::path folder = make_fresh_folder_path("place") / "saved";
    fs::create_directory(folder.parent_path());
    LogFolderOptions options;
    options.progress = [](std::string_view, double done) {
        if (done > 0.5) throw Error(ExitCode::interrupted, "interrupted");
    };
    EXPECT_THROW(save_folder(street, folder, options), Error);
    EXPECT_TRUE(list_names_in(folder.parent_path()).empty());
    save_folder(street, folder);
    EXPECT_THROW(save_folder(street, folder), UsageError);
    options.overwrite = true;
    EXPECT_THROW(save_folder(street, folder, options), Error);
    EXPECT_EQ(load_log(folder.string(), {}).frames.size(), street.frames.size())
        << "the old one stays until the new one is complete";
    Log shorter = street;
    shorter.frames.resize(2);
    shorter.world_from_vehicle.time_s.resize(1);
    shorter.world_from_vehicle.pose.resize(1);
    save_folder(shorter, folder, {.overwrite = true});
    EXPECT_EQ(load_log(folder.string(), {}).frames.size(), 2u);
    EXPECT_EQ(list_names_in(folder.parent_path()), std::vector<std::string>{"saved"});
    test::write_text(folder.parent_path() / "other/thing.txt", "x");
    EXPECT_THROW(save_folder(street, folder.parent_path() / "other", {.overwrite = true}), UsageError);
    EXPECT_TRUE(fs::exists(folder.parent_path() / "other/thing.txt"));
}

TEST(SaveFolder, DeletesNoFilesOfOthers) {
    const Log street = make_rich_street();
    for (const char* name : {"notes.txt", "labels/a.txt", "scans/000000.bin"}) {
        const fs::path folder = make_fresh_folder_path("theirs");
        save_folder(street, folder);
        test::write_text(folder / name, "x");
        EXPECT_THROW(save_folder(street, folder, {.overwrite = true}), UsageError) << name;
        EXPECT_TRUE(fs::exists(folder / name));
    }
}

TEST(PlainFolder, Formats) {
    expect_street({"pcd_text", "pcd", test::make_pcd_text, kStamped}, 1e-6);
    expect_street({"pcd_binary", "pcd", test::make_pcd_binary, kStamped}, 1e-6);
    expect_street({"pcd_lzf", "pcd", test::make_pcd_compressed, kStamped}, 1e-6);
    const char* absolute = R"(, "point_times": "absolute")";
    expect_street({"ply_text", "ply", test::make_ply_text, absolute}, 1e-6);
    expect_street({"ply_binary", "ply", test::make_ply_binary, absolute}, 1e-6);
    expect_street(
        {"npy", "npy", test::npy,
         R"(, "columns": ["x", "y", "z", "intensity", "ring", "timestamp"], "point_times": "absolute")"},
        1e-6);
}
TEST(PlainFolder, BinWithRingsAlone) {
    const PointLog files("bin", "bin", test::bin, test::kRings);
    expect_street(files, 1e-4);  // the sensor faces forward at the frame's time
    EXPECT_THAT(files.load().notes.back(), test::Names("times"));
}

TEST(PlainFolder, FindsRingsThatPointsDoNotHave) {
    expect_street({"no_rings", "bin", test::bin, test::kNoRings}, 1e-4);
}

TEST(PlainFolder, TakesBeamsThatAreGiven) {
    const PointLog files("given", "bin", test::bin, test::kRings);
    const std::string sensor = fmt::format(R"(, "lidars": [{{"sensor": {{{}, "columns": 360}}}}])",
                                           test::make_beams(files.street.lidars[0].sensor));
    for (const char* columns : {test::kRings, test::kNoRings}) {
        files.put_head(columns + sensor);
        expect_street(files, 1e-4);
    }
}

TEST(PlainFolder, CountsRingsFromBelowWhereItIsTold) {
    const auto mirror_vertically = [](test::FilePoints points) {
        for (test::FilePoint& p : points) p.ring = std::uint16_t(15 - p.ring);
        return test::bin(points);
    };
    // the sensor is fitted
    expect_street({"lowest", "bin", mirror_vertically, test::kRings}, 1e-4);
    std::string csv = "elevation_deg\n";
    const Log street = make_street_log({.n_frames = 1, .rows = 16, .columns = 8});
    for (const Beam& beam : street.lidars[0].sensor.beams)
        csv += fmt::format("{}\n", beam.elevation_rad * 180.0 / kPi);
    test::write_text(fs::path(testing::TempDir()) / "relidar_folder/lowest/beams.csv", csv);
    const PointLog files(
        "lowest_given", "bin", mirror_vertically,
        R"(, "columns": ["x", "y", "z", "intensity", "ring"], "lidars": [{"ring_0": "lowest", "sensor": "../lowest/beams.csv:360x10"}])");
    expect_street(files, 1e-4);
}

TEST(PlainFolder, ALogWithSomeOfTheScansKeepsTheSweepTime) {
    const PointLog files("thinned", "bin", test::bin, "");
    // The LiDAR makes 10 revolutions per second. Every fifth scan was kept.
    files.put_head(test::kRings, 2.0);
    EXPECT_NEAR(files.load().lidars[0].sensor.period_s, 0.1, 1e-9);
    files.put_head(test::kRings, 5.0);
    EXPECT_NEAR(files.load().lidars[0].sensor.period_s, 0.2, 1e-9);
}

TEST(PlainFolder, AScanWithoutValidPointsHasOnlyDroppedRays) {
    for (const std::size_t empty : {0, 2}) {
        const PointLog files("empty_scan", "bin", test::bin, test::kRings);
        files.change_points(empty, [](test::FilePoint& p) { p.point_m = glm::vec3(NAN); });
        const Log log = files.load();
        ASSERT_EQ(log.frames.size(), 4u);
        EXPECT_EQ(log.frames[empty].scan.count_returns(), 0u);
        EXPECT_EQ(log.frames[empty].scan.range_m.size(), log.frames[1].scan.range_m.size());
        EXPECT_THAT(log.notes.back(), test::Names(fmt::format("1 of 4 scans ... frame {}", empty)));
    }
}

TEST(PlainFolder, ALogWithoutValidPointsIsRead) {
    const PointLog files("no_points", "bin", test::bin, "");
    for (std::size_t i = 0; i < files.street.frames.size(); ++i)
        files.change_points(i, [](test::FilePoint& p) { p.point_m = glm::vec3(NAN); });
    for (const bool has_sensor : {false, true}) {
        files.put_head(std::string(test::kRings) +
                       (has_sensor ? R"(, "lidars": [{"sensor": "VLP-16:900x10"}])" : ""));
        const Log log = files.load();
        ASSERT_EQ(log.frames.size(), 4u);
        EXPECT_EQ(log.frames[1].scan.count_returns(), 0u);
        EXPECT_EQ(log.frames[1].scan.range_m.size(), has_sensor ? 16u * 900u : 0u);
        EXPECT_THAT(test::join_lines(log.notes), test::Names("finite"));
    }
}

TEST(PlainFolder, NotesASensorThatDoesNotFitThePoints) {
    const PointLog files("other_sensor", "bin", test::bin, "");
    files.put_head(test::kNoRings + fmt::format(R"(, "lidars": [{{"sensor": {{{}, "columns": 360}}}}])",
                                                test::make_beams(files.street.lidars[0].sensor, 0.1)));
    EXPECT_THAT(test::join_lines(files.load().notes), test::Names("skipped ... sequence.json"));
}

TEST(PlainFolder, KeepsPointsWithoutOrderOfALidarThatDoesNotSpin) {
    const PointLog files(
        "solid", "bin", test::bin,
        R"(, "columns": ["x", "y", "z", "intensity", "ring"], "lidars": [{"spins": false}])");
    const Log log = files.load();
    EXPECT_EQ(log.lidars[0].sensor.period_s, 0.0);
    for (std::size_t f = 0; f < log.frames.size(); ++f) {
        const test::FilePoints points = PointLog::points(files.street.frames[f]);
        ASSERT_EQ(log.frames[f].scan.rays.rows, 1);
        ASSERT_EQ(log.frames[f].scan.range_m.size(), points.size());
        for (std::size_t i = 0; i < points.size(); ++i)
            EXPECT_LT(glm::distance(log.frames[f].scan.return_point(i), points[i].point_m), 1e-4f);
    }
}

TEST(PlainFolder, UndoesMotionCompensation) {
    // The sensor drives at 8 m/s, so that it moves 0.4 m in half a sweep.
    const Log street = make_street_log(
        {.n_frames = 4, .rows = 16, .columns = 360, .range_noise_m = 0.0, .moving_cars = false});
    const PoseTrack track = street.lidar_track(0);
    std::size_t frame = 0;
    const auto compensated = [&](test::FilePoints points) {
        const double t_s = street.frames[frame++].time_s;
        for (test::FilePoint& p : points)
            p.point_m =
                glm::vec3(inverse(track.pose_at(t_s)) * (track.pose_at(p.time_s) * glm::dvec3(p.point_m)));
        return test::npy(points);
    };
    const PointLog files(
        "compensated", "npy", compensated,
        R"(, "motion_compensated": true, "columns": ["x", "y", "z", "intensity", "ring", "timestamp"], "point_times": "absolute")");
    expect_street(files, 1e-6);
    EXPECT_TRUE(files.load().rolling_shutter);
    EXPECT_FALSE(files.load({.poses_file = kNoPoses}).rolling_shutter);
}

TEST(PlainFolder, InterpolatesPosesThatHaveTimes) {
    const PointLog files("track", "bin", test::bin, test::kRings);
    // The first log has columns by position. The second log has a byte-order mark and the
    // column names of TUM, whose quaternions have w last.
    const std::string logs[] = {
        "# time x y z qw qx qy qz\n-0.05 0 0 0 1 0 0 0\n0.15 2 0 0 1 0 0 0\n0.25 2 3 0 0.9238795325112867 0 "
        "0 0.3826834323650898\n"
        "0.35 2 3 1 0.7071067811865476 0 0 0.7071067811865476\n",
        "\xEF\xBB\xBF# timestamp tx ty tz qx qy qz qw\n-0.05 0 0 0 0 0 0 1\n0.15 2 0 0 0 0 0 1\n"
        "0.25 2 3 0 0 0 0.3826834323650898 0.9238795325112867\n0.35 2 3 1 0 0 0.7071067811865476 "
        "0.7071067811865476\n"};
    for (const std::string& poses : logs) {
        test::write_text(files.folder / "poses.txt", poses);
        const Log log = files.load();
        const PoseTrack world = shift_track(log.world_from_vehicle, log.world_offset_m);
        EXPECT_LT(glm::distance(world.pose[1].translation, glm::dvec3(1.5, 0, 0)), 1e-12);  // 0.1 s
        EXPECT_LT(glm::distance(world.pose[2].translation, glm::dvec3(2, 1.5, 0)), 1e-12);  // 0.2 s
        EXPECT_NEAR(world.pose[2].rotation.z, std::sin(kPi / 16), 1e-12) << "an eighth of a turn half way";
    }
}

TEST(PlainFolder, BoxesByFrameAndYaw) {
    const PointLog files("boxes", "bin", test::bin, "");
    files.put_head(test::kRings);
    test::write_text(files.folder / "boxes.json", R"({"boxes": [
        {"track": "7", "category": "Car", "frame": 1, "size": [4, 2, 1.5], "position": [10, 1, 0.75], "yaw_deg": 90},
        {"track": "8", "category": "Van", "time_s": 0.1, "size": [5, 2, 2], "position": [1, 9, 1], "quaternion": [1, 0, 0, 0]},
        {"track": "7", "category": "Car", "frame": 2, "size": [4, 2, 1.5], "position": [11, 1, 0.75], "yaw_deg": 90}]})");
    const Log log = files.load();
    ASSERT_EQ(log.boxes.size(), 2u);
    EXPECT_EQ(log.boxes[0].id, "7");
    EXPECT_EQ(log.boxes[0].world_from_box.time_s, (std::vector<double>{0.1, 0.2}));
    const Pose& pose = log.boxes[0].world_from_box.pose[1];
    EXPECT_LT(glm::distance(pose.translation + log.world_offset_m, glm::dvec3(11, 1, 0.75)), 1e-9);
    EXPECT_LT(glm::distance(pose.rotation * glm::dvec3(1, 0, 0), glm::dvec3(0, 1, 0)), 1e-9);
    EXPECT_EQ(log.boxes[1].category, "Van");
}

TEST(PlainFolder, ReadsRenderedScans) {
    const fs::path folder = test::make_frame_folder("rendered");
    const std::vector<float> range = {5.0f, 7.0f}, median = {5.5f, 7.5f}, drop = {0.2f, 0.9f},
                             intensity = {0.25f, 0.5f};
    const std::vector<float> directions = {1, 0, 0, 0, 1, 0};
    std::vector<NamedArray> arrays{make_array("range", {1, 2}, range.data(), 2),
                                   make_array("median_range", {1, 2}, median.data(), 2),
                                   make_array("drop_prob", {1, 2}, drop.data(), 2),
                                   make_array("intensity", {1, 2}, intensity.data(), 2),
                                   make_array("directions", {1, 2, 3}, directions.data(), 6),
                                   single_text("sensor", "native")};
    write_npz(folder / "scans/frame_000000.npz", arrays);
    const Scan scan = load_log(folder.string(), {}).frames[0].scan;
    EXPECT_EQ(scan.range_m, (ScanArray<float>{5.5f, 0.0f}));
    EXPECT_EQ(scan.intensity, (ScanArray<float>{0.25f, 0.0f}));
    std::vector<NamedArray> without_number = arrays;
    without_number.push_back(make_array("divergence_rad", {0}, range.data(), 0));
    write_npz(folder / "scans/frame_000000.npz", without_number);
    EXPECT_THROW(load_log(folder.string(), {}), DataError) << "no number";
    const std::int32_t deskewed = 1;
    arrays.push_back(make_array("deskewed", {}, &deskewed, 1));
    write_npz(folder / "scans/frame_000000.npz", arrays);
    EXPECT_THROW(load_log(folder.string(), {}), DataError);
}

}  // namespace
}  // namespace relidar
