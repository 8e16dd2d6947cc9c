// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include <cstring>

#include <fmt/format.h>

#include "read/datasets/kitti/kitti_drive.hpp"
#include "read/datasets/nuscenes/nuscenes_folder.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::NuscenesFolder;
using test::YardRay;

const DatasetOptions kScene{.sequence = "scene-0103"};

Log load(const NuscenesFolder& data, DatasetOptions options = {}) {
    if (options.sequence.empty()) options.sequence = "scene-0103";
    return data.load(options);
}

/// The position is interpolated along chords, at 0.944 m from the axle with 0.0175 rad
/// per sweep. At s sweeps after the start of a chord, the arc is r angle^2 |s (s - 1)| /
/// 2 away. The first turn, s = -1 to 0, extrapolates the next chord backwards.
double measure_distance_to_arc_m(int frame, double fraction) {
    const double arc_m = 0.944 * 0.0175 * 0.0175, along = frame == 0 ? fraction - 1.0 : fraction;
    return arc_m * std::abs(along * (along - 1.0)) / 2.0 + 1e-6;
}

/// Index of the ray in the file of its sweep. `turned` is the fraction of the turn.
std::size_t find_ray(const NuscenesFolder& data, const Scan& scan, std::size_t i, double& turned) {
    turned = 1.0 + double(scan.rays.time_offset_s[i]) / NuscenesFolder::kSweep_s;
    return std::size_t(std::lround(turned * data.columns)) * 32 + 31u - scan.rays.channel[i];
}

TEST(Nuscenes, EveryRayIsWhereItWasFired) {
    const NuscenesFolder data("rays");
    EXPECT_EQ(detect_kind(data.folder), "nuscenes");
    const Log actual = load(data);
    EXPECT_EQ(actual.name, "nuScenes scene-0103");
    ASSERT_EQ(actual.frames.size(), std::size_t(NuscenesFolder::kSweeps));
    const SpinningSensor& sensor = actual.lidars[0].sensor;
    ASSERT_EQ(sensor.beams.size(), 32u);
    EXPECT_NEAR(sensor.beams[0].elevation_rad * 180.0 / kPi, 10.67, 5e-3);
    EXPECT_NEAR(sensor.beams[31].elevation_rad * 180.0 / kPi, -30.67, 5e-3);
    const PoseTrack track = actual.lidar_track(0);
    for (const Frame& frame : actual.frames) {
        ASSERT_EQ(frame.scan.rays.columns, data.columns);
        std::size_t n_returns = 0;
        for (const YardRay& ray : data.rays[std::size_t(frame.index)]) n_returns += ray.returned;
        EXPECT_EQ(frame.scan.count_returns(), n_returns);
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            const double fired_s = frame.time_s + double(frame.scan.rays.time_offset_s[i]);
            double turned;
            const YardRay& ray = data.rays[std::size_t(frame.index)][find_ray(data, frame.scan, i, turned)];
            const bool returned = frame.scan.range_m[i] > 0.0f;
            ASSERT_NEAR(fired_s, ray.time_s, 1e-7);
            ASSERT_EQ(returned, ray.returned) << i;
            const auto [origin_m, point_m] = test::place_return(actual, track, frame, i);
            const double off_m = measure_distance_to_arc_m(frame.index, turned);
            ASSERT_LT(glm::distance(origin_m, ray.origin_m), off_m);
            ASSERT_LT(glm::distance(glm::dvec3(frame.scan.rays.direction[i]), ray.direction),
                      returned ? off_m / 4.0 + 1e-6 : 4e-4)
                << i;
            if (!returned) continue;
            ASSERT_LT(glm::distance(point_m, ray.point_m), 1e-4);
            ASSERT_FLOAT_EQ(frame.scan.intensity[i], 0.2f);
        }
    }
}

/// The point with index i has the category i % 3.
void write_categories(const NuscenesFolder& data) {
    test::write_text(data.table("category"),
                     R"([{"token": "animal", "name": "animal", "index": 1},
                         {"token": "vehicle", "name": "vehicle.car", "index": 2},
                         {"token": "noise", "name": "noise", "index": 0}])");
    std::string table;
    for (const int sweep : {0, 10}) {
        const std::string file = fmt::format("lidarseg/v1.0-mini/{}_lidarseg.bin", sweep);
        table += fmt::format(R"({}{{"token": "x{}", "sample_data_token": "d{}", "filename": "{}"}})",
                             table.empty() ? "" : ", ", sweep, sweep, file);
        std::string bytes;
        for (std::size_t i = 0; i < fs::file_size(data.sweep(sweep)) / 20; ++i) bytes += char(i % 3);
        test::write_text(data.folder / file, bytes);
    }
    test::write_text(data.table("lidarseg"), "[" + table + "]");
}

// In Boston, 0.001 degrees of latitude are 111.32 m.
TEST(Nuscenes, KnowsThePlacesOfItsMaps) {
    const NuscenesFolder data("maps");
    EXPECT_FALSE(load(data).georeference);
    test::write_records(data.table("log"), {R"("token": "a")"});
    EXPECT_FALSE(load(data).georeference) << "a log without a location";
    test::write_records(
        data.table("scene"),
        {R"("token": "s1", "name": "scene-0103", "first_sample_token": "k0", "log_token": "b")"});
    test::write_records(data.table("log"), {R"("token": "a", "location": "singapore-queenstown")",
                                            R"("token": "b", "location": "boston-seaport")"});
    const Log log = load(data);
    ASSERT_TRUE(log.georeference);
    EXPECT_EQ(log.georeference->point_m, glm::dvec3(0.0));
    if (!has_proj()) GTEST_SKIP() << "built without PROJ";
    const glm::dvec3 corner =
        GeoConverter(*log.georeference).to_dataset({42.337849169438615, -71.05785369873047});
    EXPECT_LT(glm::distance(corner, glm::dvec3(0.0, 1e-3 * kPi / 180.0 * 6378137.0, 0.0)), 1e-3);
}

TEST(Nuscenes, ReadsTheClassesOfLidarseg) {
    const NuscenesFolder data("lidarseg");
    write_categories(data);
    const Log actual = load(data);
    for (const Frame& frame : actual.frames) {
        const Scan& scan = frame.scan;
        ASSERT_EQ(scan.classes.size(), frame.index % 10 == 0 ? scan.range_m.size() : 0u);
        for (std::size_t i = 0; i < scan.classes.size(); ++i) {
            double turned;
            const std::size_t point = find_ray(data, scan, i, turned);
            SurfaceClass expected = SurfaceClass::vehicle;
            if (scan.range_m[i] == 0.0f || point % 3 == 0) expected = SurfaceClass::unknown;
            else if (point % 3 == 1) expected = SurfaceClass::other_actor;
            ASSERT_EQ(scan.classes[i], expected) << i;
        }
    }
}

TEST(Nuscenes, RefusesDamagedLabelsOfPoints) {
    const NuscenesFolder data("bad_lidarseg", 40);
    write_categories(data);
    const fs::path file = data.folder / "lidarseg/v1.0-mini/10_lidarseg.bin";
    data.expect_error_with(file, "123", "10_lidarseg.bin ... 3 bytes ... 1280", kScene);
    fs::remove(file);
    const Log log = load(data);
    EXPECT_THAT(log.notes,
                testing::Contains("labels of points: 1 of the files in lidarseg.json are missing"));
    EXPECT_TRUE(log.frames[10].scan.classes.empty());
    EXPECT_FALSE(log.frames[0].scan.classes.empty());
    test::write_text(data.table("category"),
                     R"([{"token": "vehicle", "name": "vehicle.car", "index": 256}])");
    data.expect_error("key 'index' ... 256 ... 'vehicle.car' ... 0 ... 255", kScene);
}

TEST(Nuscenes, TablesOfT4) {
    const NuscenesFolder data("t4");
    const Log nuscenes = load(data);
    fs::rename(data.folder / "v1.0-mini", data.folder / "annotation");
    EXPECT_EQ(detect_kind(data.folder), "t4");
    const Log t4 = load(data);
    EXPECT_EQ(t4.name, "T4 scene-0103");
    ASSERT_EQ(t4.frames.size(), nuscenes.frames.size());
    EXPECT_EQ(t4.boxes.size(), nuscenes.boxes.size());
    for (std::size_t i = 0; i < t4.frames.size(); ++i) {
        // A point has five float32 in the file. Points near the sensor must also be
        // returns.
        EXPECT_EQ(t4.frames[i].scan.count_returns(), fs::file_size(data.sweep(int(i))) / 20);
    }
}

TEST(Nuscenes, TimesPosesAndBoxesBetweenKeyframes) {
    const NuscenesFolder data("boxes", 40);
    const Log actual = load(data);
    EXPECT_EQ(actual.start_unix_ns, 1533151603547590000);
    for (std::size_t i = 0; i < actual.frames.size(); ++i) {
        EXPECT_NEAR(actual.frames[i].time_s, double(i) * NuscenesFolder::kSweep_s, 1e-9);
        test::expect_pose(actual, actual.world_from_vehicle.pose[i],
                          NuscenesFolder::compute_vehicle_pose(actual.frames[i].time_s));
    }
    ASSERT_EQ(actual.boxes.size(), 1u) << "the dog is in another scene";
    const BoxTrack& box = actual.boxes[0];
    EXPECT_EQ(box.category, "vehicle.car");
    EXPECT_EQ(box.size_m, glm::dvec3(4.5, 1.9, 1.6)) << "length first";
    ASSERT_EQ(box.world_from_box.pose.size(), actual.frames.size());
    for (std::size_t i = 0; i < actual.frames.size(); ++i)
        test::expect_pose(actual, box.world_from_box.pose[i],
                          NuscenesFolder::box_at(actual.frames[i].time_s));
}

/// The mounting of the fixture's camera is that of the vehicle.
TEST(Nuscenes, CamerasHaveTheirCalibration) {
    const Log log = load(NuscenesFolder("cameras", 40));
    ASSERT_EQ(log.cameras.size(), 1u);
    const Camera& camera = log.cameras[0];
    EXPECT_EQ(camera.name, "CAM_FRONT");
    EXPECT_EQ(camera.columns, 1600);
    EXPECT_EQ(camera.rows, 900);
    EXPECT_LT(glm::distance(*camera.project({1.0, 2.0, 4.0}),
                            glm::dvec2(816.3 + 1266.4 / 4.0, 491.5 + 1266.5 / 2.0)),
              1e-9);
    const glm::dvec3 point_m(3.0, -2.0, 5.0);  // in the frame of the vehicle and the camera
    EXPECT_LT(glm::distance(log.lidars[0].vehicle_from_sensor * camera.rig_from_camera * point_m, point_m),
              1e-9);
}

TEST(Nuscenes, ScenesFramesAndPoses) {
    const NuscenesFolder data("scenes", 40);
    EXPECT_EQ(data.load().name, "nuScenes scene-0061");
    EXPECT_EQ(data.load().frames.size(), 1u);
    EXPECT_EQ(load(data, {.sequence = "103"}).name, "nuScenes scene-0103");
    data.expect_error("dataset.sequence 'scene-0104' ... scene-0061, scene-0103", {.sequence = "scene-0104"});
    const Log part = load(data, {.frames = {3, 5}});
    ASSERT_EQ(part.frames.size(), 2u);
    EXPECT_EQ(part.frames[0].index, 3);
    EXPECT_NEAR(part.frames[0].time_s, 0.15, 1e-9);
    EXPECT_THROW(load(data, {.frames = {11, -1}}), UsageError);
    const Log unposed = load(data, {.poses_file = kNoPoses});
    EXPECT_EQ(unposed.world_from_vehicle.pose[4].translation, glm::dvec3(0.0));
    const glm::dvec3 box_in_vehicle_m =
        inverse(NuscenesFolder::compute_vehicle_pose(0.2)) * NuscenesFolder::box_at(0.2).translation;
    EXPECT_LT(glm::distance(unposed.boxes[0].world_from_box.pose[4].translation, box_in_vehicle_m), 1e-8);
    test::write_text(data.table("sample_annotation"), "[]");
    EXPECT_THAT(load(data).notes, testing::Contains(test::Names("annotations")));
}

TEST(Nuscenes, KeyframesAlone) {
    const NuscenesFolder data("keyframes", 40);
    fs::remove(data.sweep(4));
    data.expect_error("turn_4.pcd.bin ... use dataset.skip_broken=true", kScene);
    EXPECT_EQ(load(data, {.skip_broken = true}).frames.size(), std::size_t(NuscenesFolder::kSweeps - 1));
    fs::remove_all(data.folder / "sweeps");
    const Log actual = load(data);
    EXPECT_THAT(actual.notes, testing::Contains(test::Names("keyframes")));
    ASSERT_EQ(actual.frames.size(), 2u);
    EXPECT_EQ(actual.frames[1].index, 10);
    EXPECT_NEAR(actual.frames[1].time_s, 0.5, 1e-9);
    EXPECT_EQ(actual.boxes[0].world_from_box.time_s, (std::vector<double>{0.0, actual.frames[1].time_s}));
    const PoseTrack track = actual.lidar_track(0);
    for (const Frame& frame : actual.frames)
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            if (frame.scan.range_m[i] == 0.0f) continue;
            double turned;
            const YardRay& ray = data.rays[std::size_t(frame.index)][find_ray(data, frame.scan, i, turned)];
            const auto [origin_m, point_m] = test::place_return(actual, track, frame, i);
            // The chord between poses is half a second long, and the LiDAR turns about
            // the axle.
            const double s = (frame.index == 0 ? 0.0 : 1.0) + 0.1 * (turned - 1.0),
                         arc_m = 0.944 * 0.175 * 0.175;
            ASSERT_LT(glm::distance(origin_m, ray.origin_m), arc_m * std::abs(s * (s - 1.0)) / 2.0 + 1e-5);
            ASSERT_LT(glm::distance(point_m, ray.point_m), 1e-4);
        }
    EXPECT_THROW(load(data, {.frames = {1, 10}}), UsageError);
}

TEST(Nuscenes, SaysWhichRecordIsWrong) {
    const NuscenesFolder data("tables", 40);
    const auto expect = [&](const std::string& table, const std::string& from, const std::string& to,
                            const std::string& part) {
        const fs::path file = data.table(table);
        data.expect_error_with(file, test::replace_first(test::read_text(file), from, to),
                               table + ".json ... " + part, kScene);
    };
    expect("scene", R"("name")", R"("nome")", "record 0, key 'name'");
    expect("sample_data", R"("timestamp": 1533)", R"("timestamp": true, "was": 1533)",
           "key 'timestamp' ... number");
    expect("sample_data", R"("is_key_frame": true)", R"("is_key_frame": 1)", "key 'is_key_frame'");
    expect("sample_data", R"("next": "d5")", R"("next": "d99")", "key 'next' ... 'd99' ... 5");
    expect("sample_data", R"("next": "d5")", R"("next": "d3")", "key 'next'");  // a cycle
    expect("sample_data", R"("next": "")", R"("next": "gone")", "key 'next' ... 'gone' ... 11");
    expect("sensor", "LIDAR_TOP", "RADAR", "key 'channel' ... LIDAR_");
    expect("sample_data", "turn_0.pcd.bin", "turn_0.las", "'samples/LIDAR_TOP/turn_0.las'");
    expect("calibrated_sensor", R"("rotation": [)", R"("rotation": [3, )", "key 'rotation' ... 4");
    expect("calibrated_sensor", R"("rotation": [0.7)", R"("rotation": [9.7)",
           "key 'rotation' ... quaternion ... 1");
    expect("ego_pose", R"("token": "e5")", R"("token": "e55")",
           "'e5' ... missing ... sweeps/LIDAR_TOP/turn_5.pcd.bin");
    expect("ego_pose", R"("translation": [)", R"("translation": ["x", )", "key 'translation' ... 3");
    expect("instance", R"("category_token": "vehicle")", R"("category_token": "?")", "'car' ... category");
    expect("sample", "[\n", "x", "'x' ... objects");
    expect("sample", "}\n]", "", "truncated");
    expect("sample", "\n]", "", "truncated");
    expect("sample", R"("token": "k1",)", R"("token" "k1",)", "record 0: ");
    fs::remove(data.table("ego_pose"));
    EXPECT_THROW(load(data), DataError);
}

TEST(Nuscenes, SaysWhichFileIsWrong) {
    const NuscenesFolder data("files", 40);
    const std::string good = test::read_text(data.sweep(4));
    const auto expect = [&](const std::string& bytes, const std::string& parts) {
        data.expect_error_with(data.sweep(4), bytes, "turn_4.pcd.bin ... " + parts, kScene);
    };
    const auto with = [&](std::size_t point, std::size_t field, float value) {
        std::string bytes = good;
        std::memcpy(bytes.data() + 20 * point + 4 * field, &value, 4);
        return bytes;
    };
    expect("", "0 bytes ... 32 ... 20");
    expect(good.substr(0, good.size() - 20), "25580 bytes ... 32");
    expect(with(7, 1, NAN), "point 7 ... (");
    expect(with(7, 2, 2e4f), "point 7 ... (");
    expect(with(7, 3, INFINITY), "point 7 ... (");
    expect(with(7, 4, 32.0f), "point 7 ... ring 32 ... 31");
    expect(with(7, 4, 0.5f), "point 7 ... ring 0.5 ... 31");
    expect(std::string(640, '\0'), "points ... 1 m");
    fs::remove(data.sweep(4));
    EXPECT_THROW(load(data), DataError);
    fs::remove(data.table("scene"));
    EXPECT_THROW(load(data), DataError);
}

}  // namespace
}  // namespace relidar
