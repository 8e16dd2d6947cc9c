// SPDX-License-Identifier: Apache-2.0
// Tests the layouts of data sets on exact scans of two boxes on level ground: numbers of
// the labels against closed forms, labels of points, appended sequences, and the tables
// of nuScenes with the reader of relidar. tests/tools/read_layouts.py reads all files.

#include <array>
#include <cstring>
#include <fstream>
#include <set>
#include <sstream>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include <relidar/read/dataset.hpp>

#include "base/codecs/npy.hpp"
#include "layouts_fixture.hpp"
#include "log/classes/dataset_classes.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

using namespace test;

TEST_F(Layouts, UsersNameTheClasses) {
    sensors.resize(1);
    sensors[0].options.actors[0].category = "vehicle.car";
    std::ofstream(folder / "names.json") << R"({"Car": "Vehicle", "Pedestrian": ""})";
    std::ofstream(folder / "names.toml") << "\"vehicle.car\" = \"Limousine\"\n";
    for (const auto& [file, expected] :
         {std::pair("names.json", "Vehicle\n"), {"names.toml", "Limousine\n.* Pedestrian\n"}}) {
        const std::filesystem::path data = folder / "data" / file;
        DatasetSequenceWriter writer(data, "custom", sensors, {kStart_s}, false,
                                     {.class_names = read_class_names(folder / file)});
        writer.write_scans(std::vector{cast_rays(kStart_s, Pose{}, -45.0, ring_step_rad)});
        writer.finish();
        EXPECT_THAT(read_contents(data / "labels/000000.txt"),
                    testing::MatchesRegex(fmt::format("[^\n]* {}", expected)));
    }
    std::ofstream(folder / "spaces.json") << R"({"Car": "big car"})";
    EXPECT_THAT(get_data_error_message([&] { read_class_names(folder / "spaces.json"); }),
                test::Names("spaces.json: Car: ... \"big car\" ... without spaces"));
    std::ofstream(folder / "list.json") << "[1]";
    EXPECT_THAT(get_data_error_message([&] { read_class_names(folder / "list.json"); }),
                test::Names("list.json ... pairs"));
}

TEST_F(Layouts, SequencesAreAppendedAndReplaced) {
    for (const std::uint64_t seed : {1, 2}) write_sequence("kitti", seed);
    EXPECT_THROW(write_sequence("kitti", 2), UsageError) << "the same settings";
    EXPECT_THROW(write_sequence("nuscenes", 3), UsageError) << "another layout";
    const std::string first = read_contents(folder / "training/label_2/000004.txt");
    write_sequence("kitti", 1, true);
    EXPECT_EQ(read_contents(folder / "ImageSets/train.txt"), "000000\n000001\n");
    EXPECT_EQ(read_contents(folder / "ImageSets/val.txt"), "000002\n000003\n000004\n000005\n");
    EXPECT_EQ(read_contents(folder / "training/label_2/000004.txt"), first);
    EXPECT_TRUE(std::filesystem::exists(folder / "tracking/training/velodyne/0001/000002.bin"));
    EXPECT_THROW(check_dataset_folder(folder / "training", "kitti"), UsageError) << "files of others";
    { DatasetSequenceWriter interrupted(folder, "kitti", sensors, times_s, true); }
    EXPECT_TRUE(std::filesystem::exists(folder / "tracking/training/velodyne/0000/000002.bin"));
    for (DatasetSensor& sensor : sensors) sensor.description = "other rays";
    write_sequence("kitti", 1);
    EXPECT_TRUE(std::filesystem::exists(folder / "training/velodyne/000008.bin")) << "another path or sensor";
}

TEST_F(Layouts, ReaderFindsBoxesAndPointsOfNuscenes) {
    for (const std::uint64_t seed : {1, 2}) write_sequence("nuscenes", seed);
    write_sequence("nuscenes", 1, true);
    const Log first = load_log("nuscenes:" + folder.string(), {});
    EXPECT_TRUE(first.name.ends_with("scene-0019")) << "a replaced scene keeps its place";
    EXPECT_EQ(first.frames.size(), 2u * (kSequenceFrames - 1)) << "the last frame is in the validation split";
    const Log log = load_log("nuscenes:" + folder.string(), {.sequence = "scene-0013"});
    ASSERT_EQ(log.frames.size(), 2u * kSequenceFrames);
    ASSERT_EQ(log.boxes.size(), 2u);
    EXPECT_FALSE(log.rolling_shutter);
    for (const BoxTrack& box : log.boxes) {
        const bool is_car = box.category == "vehicle.car";
        EXPECT_EQ(box.category, is_car ? "vehicle.car" : "human.pedestrian.adult");
        EXPECT_LT(glm::distance(box.size_m, is_car ? kCarSize_m : kWalkerSize_m), 1e-9);
        for (int i = 0; i < kSequenceFrames; ++i) {
            const double t = times_s[std::size_t(i)];
            const Pose expected = is_car ? car_pose(t) : walker_pose(t),
                       found = box.world_from_box.pose[std::size_t(i)];
            EXPECT_LT(glm::distance(found.translation + log.world_offset_m, expected.translation), 1e-6);
        }
    }
    for (const Frame& frame : log.frames) {
        EXPECT_EQ(std::ranges::count(frame.scan.rays.time_offset_s, 0.0f),
                  std::ssize(frame.scan.rays.time_offset_s));
        const Lidar& lidar = log.lidar_of(frame);
        const Pose world_from_lidar =
            log.world_from_vehicle.pose[log.find_pose_index(frame)] * lidar.vehicle_from_sensor;
        for (std::size_t i = 0; i < frame.scan.range_m.size(); i += 97) {
            if (!(frame.scan.range_m[i] > 0.0f)) continue;
            const glm::dvec3 point =
                world_from_lidar * glm::dvec3(frame.scan.return_point(i)) + log.world_offset_m;
            if (point.z >= 0.01) continue;
            EXPECT_NEAR(point.z, 0.0, 2e-3) << "the ground is level";
        }
    }
    std::ofstream(folder / "v1.0-trainval/sample.json") << "[{";
    EXPECT_THROW(write_sequence("nuscenes", 3), DataError) << "a truncated table";
}

/// Compares with the lists of create_splits_scenes() of the development kit.
TEST_F(Layouts, NuscenesScenesHaveOfficialNamesOfTheirSplit) {
    using nlohmann::json;
    const auto read_json = [&](const std::string& name) {
        return json::parse(read_contents(folder / "v1.0-trainval" / (name + ".json")));
    };
    write_sequence("nuscenes", 0);
    EXPECT_EQ(read_json("splits"), json({{"train", {"scene-0019"}}, {"val", {"scene-0012"}}}));
    for (const std::uint64_t seed : {1, 2, 3, 4, 5, 6}) write_sequence("nuscenes", seed);
    const json train = {"scene-0019", "scene-0020", "scene-0021", "scene-0022", "scene-0023"};
    EXPECT_EQ(read_json("splits"),
              json({{"train", train}, {"val", {"scene-0012", "scene-0013", "scene-0014"}}}));
    std::map<std::string, std::string> scene_of;
    for (const json& sample : read_json("sample")) scene_of[sample["token"]] = sample["scene_token"];
    for (const json& scene : read_json("scene")) {
        EXPECT_EQ(scene["nbr_samples"], scene["name"] == "scene-0019"   ? kSequenceFrames - 1
                                        : scene["name"] == "scene-0012" ? 1
                                                                        : kSequenceFrames);
        EXPECT_EQ(scene_of[scene["first_sample_token"]], scene["token"]);
        EXPECT_EQ(scene_of[scene["last_sample_token"]], scene["token"]);
    }
    for (const char* table : {"sample", "sample_data", "sample_annotation"}) {
        const json records = read_json(table);
        const std::string sample = table == std::string("sample") ? "token" : "sample_token";
        std::map<std::string, std::string> scene_of_record;
        for (const json& record : records) scene_of_record[record["token"]] = scene_of[record[sample]];
        for (const json& record : records)
            if (const std::string next = record["next"]; !next.empty()) {
                EXPECT_EQ(scene_of_record[next], scene_of_record[record["token"]]) << table;
            }
    }
}

Pose parse_record(const nlohmann::json& record) {
    const auto& q = record["rotation"];
    const auto& t = record["translation"];
    return {{q[0], q[1], q[2], q[3]}, {t[0], t[1], t[2]}};
}

/// Projects the centre of the car with the tables, as the development kit does.
TEST_F(Layouts, NuscenesCameraSeesTheCarAtItsPixel) {
    using nlohmann::json;
    const DatasetView view{
        .camera = Camera{.name = "front",
                         .focal_x_px = 500.0,
                         .focal_y_px = 510.0,
                         .centre_x_px = 330.0,
                         .centre_y_px = 170.0,
                         .columns = 640,
                         .rows = 360,
                         .rig_from_camera = {glm::dquat(0.5, -0.5, 0.5, -0.5), {0.3, 0.1, -0.2}}}};
    for (DatasetSensor& sensor : sensors)
        sensor.options.vehicle_from_lidar = {glm::angleAxis(0.3, glm::dvec3(0, 0, 1)), {1.0, 0.2, 1.5}};
    RenderedScan picture;
    picture.image.rows = 360;
    picture.image.columns = 640;
    picture.image.range_m.assign(640 * 360, 5.0f);
    picture = test::complete(std::move(picture));
    write_sequence("nuscenes", 0, false, view);
    write_sequence("nuscenes", 1, false, view, &picture);
    std::map<std::string, std::map<std::string, json>> tables;
    for (const char* table : {"sensor", "calibrated_sensor", "ego_pose", "sample_data", "sample_annotation"})
        for (const json& record :
             json::parse(read_contents(folder / "v1.0-trainval" / (std::string(table) + ".json"))))
            tables[table][record["token"]] = record;
    std::map<std::string, std::set<std::string>> files;  // by channel
    int n_projected = 0;
    for (const auto& [token, data] : tables["sample_data"]) {
        const json &mount = tables["calibrated_sensor"].at(data["calibrated_sensor_token"]),
                   &sensor = tables["sensor"].at(mount["sensor_token"]);
        const std::string file = data["filename"];
        if (sensor["modality"] != "camera") continue;
        files[sensor["channel"]].insert(file);
        EXPECT_EQ(data["width"], 640);
        EXPECT_EQ(data["height"], 360);
        EXPECT_TRUE(std::filesystem::exists(folder / file)) << file;
        if (sensor["channel"] != "CAM_FRONT") continue;
        const Pose world_from_camera =
            parse_record(tables["ego_pose"].at(data["ego_pose_token"])) * parse_record(mount);
        for (const auto& [box_token, box] : tables["sample_annotation"])
            if (box["sample_token"] == data["sample_token"] && box["size"][1] == kCarSize_m.x) {
                const glm::dvec3 centre = inverse(world_from_camera) * parse_record(box).translation;
                const auto& k = mount["camera_intrinsic"];
                const auto pixel = [&](int row) {
                    return (k[row][0].get<double>() * centre.x + k[row][1].get<double>() * centre.y) /
                               centre.z +
                           k[row][2].get<double>();
                };
                // The car is 10 m before, 2 m left of and 1.25 m below the rig.
                EXPECT_NEAR(pixel(0), 330.0 - 500.0 * 1.9 / 9.7, 1e-6);
                EXPECT_NEAR(pixel(1), 170.0 + 510.0 * 1.05 / 9.7, 1e-6);
                ++n_projected;
            }
    }
    EXPECT_EQ(n_projected, 2 * kSequenceFrames);
    EXPECT_EQ(files.size(), 6u) << "mmdet3d reads six channels";
    EXPECT_EQ(files["CAM_FRONT"].size(), 1u + kSequenceFrames) << "a black picture, and one for each frame";
    EXPECT_EQ(files["CAM_BACK"].size(), 2u);
    EXPECT_NE(read_contents(folder / *files["CAM_FRONT"].begin()),
              read_contents(folder / *files["CAM_FRONT"].rbegin()));
}

/// OpenPCDet fails on categories that nuScenes does not have.
TEST_F(Layouts, NuscenesHasOnlyItsCategories) {
    for (DatasetSensor& sensor : sensors) sensor.options.actors[0].category = "Tram";
    write_sequence("nuscenes", 0);
    std::set<std::string> found;
    for (const auto& record : nlohmann::json::parse(read_contents(folder / "v1.0-trainval/category.json")))
        found.insert(record.at("name").get<std::string>());
    EXPECT_EQ(found, (std::set<std::string>{"human.pedestrian.adult", "movable_object.debris"}));
}

TEST_F(Layouts, CustomFilesHaveTheSamePointsAndTheBoxesOfTheRig) {
    write_sequence("custom", 0);
    EXPECT_EQ(read_contents(folder / "labels/000001.txt"),
              "10.0000 2.0000 -1.2500 4.0000 2.0000 1.5000 0.4000 Car\n"
              "4.0000 4.0000 -1.1000 0.6000 0.6000 1.8000 0.7854 Pedestrian\n");
    const std::string bin = read_contents(folder / "points/000001.bin");
    const NamedArray npy = codecs::parse_npy("points", read_contents(folder / "points/000001.npy"));
    EXPECT_EQ(npy.shape, (ArrayShape{bin.size() / 16, 4}));
    EXPECT_EQ(npy.dtype, "f4");
    ASSERT_EQ(npy.bytes.size(), bin.size());
    EXPECT_EQ(std::memcmp(npy.bytes.data(), bin.data(), bin.size()), 0);
    for (DatasetSensor& sensor : sensors) sensor.options.actors.clear();
    write_sequence("custom", 1);
    EXPECT_EQ(read_contents(folder / "labels/000004.txt"), "");
    EXPECT_EQ(read_contents(folder / "ImageSets/train.txt"), "000000\n000001\n");
    EXPECT_EQ(read_contents(folder / "ImageSets/val.txt"), "000002\n") << "frames without boxes";
}

/// With the usual step, the farthest ring is at 400.00 m, which readers take for rays
/// without return.
constexpr double kRingStep_rad = 0.02;

using SortedPoints = std::set<std::array<float, 3>>;

/// Returns the largest distance from a point of `a` to the nearest point of `b`. Compares
/// only points with about the same x, because this is faster.
double largest_distance_m(const SortedPoints& a, const SortedPoints& b) {
    constexpr float kWindow_m = 1e-3f;
    double largest_m = 0.0;
    for (const auto& p : a) {
        double nearest_m = INFINITY;
        for (auto q = b.lower_bound({p[0] - kWindow_m, -INFINITY, -INFINITY});
             q != b.end() && (*q)[0] <= p[0] + kWindow_m; ++q)
            nearest_m = std::min(nearest_m, glm::distance(glm::dvec3(p[0], p[1], p[2]),
                                                          glm::dvec3((*q)[0], (*q)[1], (*q)[2])));
        largest_m = std::max(largest_m, nearest_m);
    }
    return largest_m;
}

/// Compares the points of a scan with those of a file of KITTI.
void expect_points(const Scan& scan, const std::filesystem::path& file) {
    const std::string bytes = read_contents(file);
    SortedPoints expected, found;
    for (std::size_t at = 0; at < bytes.size(); at += 16) {
        std::array<float, 3> point;
        std::memcpy(&point, bytes.data() + at, sizeof point);
        expected.insert(point);
    }
    for (std::size_t i = 0; i < scan.range_m.size(); ++i)
        if (scan.range_m[i] > 0.0f) {
            const glm::vec3 point = scan.return_point(i);
            found.insert({point.x, point.y, point.z});
        }
    EXPECT_GT(expected.size(), 20'000u);
    EXPECT_LT(largest_distance_m(expected, found), 1e-3);
    EXPECT_LT(largest_distance_m(found, expected), 1e-3);
}

TEST_F(Layouts, ReaderFindsBoxesAndPointsOfKitti) {
    sensors.resize(1);
    ring_step_rad = kRingStep_rad;
    const GeodeticPosition place{48.985, 8.394, 116.5};
    sensors[0].options.georeference =
        Georeference{place, rig_pose(times_s[0]).translation, local_tangent_crs(place)};
    for (const std::uint64_t seed : {1, 2}) write_sequence("kitti", seed);
    EXPECT_EQ(detect_kind(folder), "kitti_tracking");
    const DatasetOptions options{.sequence = "1", .max_range_m = 1000.0};
    const Log log = load_log(folder.string(), options);
    ASSERT_EQ(log.frames.size(), std::size_t(kSequenceFrames));
    ASSERT_TRUE(log.georeference);
    EXPECT_NEAR(log.georeference->position.latitude_deg, place.latitude_deg, 1e-9);
    EXPECT_NEAR(log.georeference->position.longitude_deg, place.longitude_deg, 1e-9);
    EXPECT_NEAR(log.georeference->position.height_m, place.height_m, 1e-5);
    // Columns 0 and 1241 of camera 2, which looks to the left by 0.0002.
    ASSERT_TRUE(log.labelled_azimuth);
    EXPECT_NEAR(log.labelled_azimuth->left_rad, std::atan(609.5593 / 721.5377), 2e-3);
    EXPECT_NEAR(log.labelled_azimuth->right_rad, -std::atan((1241 - 609.5593) / 721.5377), 2e-3);
    EXPECT_FALSE(log.rolling_shutter);
    ASSERT_EQ(log.boxes.size(), 2u);
    for (const BoxTrack& box : log.boxes) {
        const bool is_car = box.category == "Car";
        EXPECT_EQ(box.category, is_car ? "Car" : "Pedestrian");
        EXPECT_LT(glm::distance(box.size_m, is_car ? kCarSize_m : kWalkerSize_m), 1e-3);
        ASSERT_EQ(box.world_from_box.pose.size(), std::size_t(kSequenceFrames));
        for (int i = 0; i < kSequenceFrames; ++i) {
            const double t = times_s[std::size_t(i)];
            const Pose expected = inverse(rig_pose(t)) * (is_car ? car_pose(t) : walker_pose(t)),
                       found = inverse(log.world_from_vehicle.pose[std::size_t(i)]) *
                               box.world_from_box.pose[std::size_t(i)];
            EXPECT_LT(glm::distance(found.translation, expected.translation), 1e-3);
            EXPECT_LT(glm::angle(glm::inverse(found.rotation) * expected.rotation), 1e-3);
        }
    }
    for (std::size_t i = 0; i < times_s.size(); ++i) {
        const Pose first_from_rig = inverse(rig_pose(times_s[0])) * rig_pose(times_s[i]);
        EXPECT_LT(glm::distance(log.world_from_vehicle.pose[i].translation + log.world_offset_m,
                                first_from_rig.translation),
                  1e-5);
        EXPECT_NEAR(log.frames[i].time_s - log.frames[0].time_s, times_s[i] - times_s[0], 1e-6);
    }
    for (const Frame& frame : log.frames)
        expect_points(frame.scan,
                      folder / "tracking/training/velodyne/0001" / fmt::format("{:06}.bin", frame.index));
    const Log object = load_log("kitti_object:" + folder.string(), {.max_range_m = 1000.0});
    ASSERT_EQ(object.frames.size(), 2u * kSequenceFrames);
    expect_points(object.frames[4].scan, folder / "training/velodyne/000004.bin");
}

TEST_F(Layouts, ReaderFindsPosesClassesAndPointsOfOpenlabel) {
    sensors.resize(1);
    ring_step_rad = kRingStep_rad;
    write_sequence("openlabel", 0);
    const std::filesystem::path sequence = folder / "sequences/00";
    for (const bool is_complete : {true, false}) {
        if (!is_complete)
            for (const char* file : {"calib.txt", "times.txt"}) std::filesystem::remove(sequence / file);
        const Log log = load_log(sequence.string(), {.max_range_m = 1000.0});
        ASSERT_EQ(log.frames.size(), std::size_t(kSequenceFrames));
        EXPECT_NEAR(log.frames[1].time_s - log.frames[0].time_s, is_complete ? 0.5 : 0.1, 1e-9);
        for (std::size_t i = 0; i < log.frames.size(); ++i) {
            const Pose first_from_rig = inverse(rig_pose(times_s[0])) * rig_pose(times_s[i]);
            EXPECT_LT(glm::distance(log.world_from_vehicle.pose[i].translation + log.world_offset_m,
                                    first_from_rig.translation),
                      1e-3);
            expect_points(log.frames[i].scan, sequence / fmt::format("velodyne/{:06}.bin", i));
        }
        EXPECT_TRUE(std::ranges::count(log.frames[0].scan.classes, SurfaceClass::vehicle) > 0);
    }
}

TEST_F(Layouts, PointsHaveTheClassAndNumberOfTheirObject) {
    write_sequence("openlabel", 0);
    const std::string bytes = read_contents(folder / "sequences/00/labels/000000.label");
    std::map<std::uint32_t, std::size_t> n_points;
    for (std::size_t i = 0; i < bytes.size(); i += 4) ++n_points[read_at<std::uint32_t>(bytes, i)];
    std::map<std::uint32_t, std::size_t> expected;
    for (const RenderedScan& scan :
         {cast_rays(kStart_s, Pose{}, -45.0), cast_rays(kStart_s, kSecondMounting, -300.0)})
        for (const int instance : scan.instance)
            if (instance >= 0)
                ++expected[instance == 0 ? 0u : instance == 1 ? 1u << 16 | 252u : 2u << 16 | 254u];
    EXPECT_EQ(n_points, expected);
    for (std::size_t i = 0; i < kSurfaceClasses; ++i) {
        const SurfaceClass surface{std::uint8_t(i)};
        const bool has_label = surface != SurfaceClass::other_actor && surface != SurfaceClass::ego;
        EXPECT_EQ(from_semantic_kitti(to_semantic_kitti(surface)), has_label ? surface : SurfaceClass{});
    }
}

/// No point is in these small boxes, so a test of positions would lose all objects.
TEST_F(Layouts, ObjectsHaveThePointsOfTheirInstance) {
    for (DatasetSensor& sensor : sensors)
        for (BoxTrack& box : sensor.options.actors) box.size_m *= 0.5;
    write_sequence("nuscenes", 0);
    std::multiset<std::size_t> expected, found;
    for (const double t : times_s)
        for (const int instance : {1, 2})
            expected.insert(
                std::size_t(std::ranges::count(cast_rays(t, Pose{}, -45.0).instance, instance) +
                            std::ranges::count(cast_rays(t, kSecondMounting, -300.0).instance, instance)));
    const std::string table = read_contents(folder / "v1.0-trainval/sample_annotation.json");
    for (const auto& record : nlohmann::json::parse(table))
        found.insert(record.at("num_lidar_pts").get<std::size_t>());
    EXPECT_EQ(found, expected);
}

TEST_F(Layouts, RejectWhatALayoutCannotStore) {
    sensors[0].options.frame_id = "a-b";
    sensors[1].options.frame_id = "A_b";
    sensors.push_back(sensors[0]);
    sensors[0].options.frame_id = "top";
    EXPECT_THROW(DatasetSequenceWriter(folder, "nuscenes", sensors, times_s, false), UsageError);
    EXPECT_THROW(check_dataset_folder(folder / "new", "pascal"), UsageError);
    times_s.assign(1'000'001, kStart_s);
    ScratchFolder other;
    EXPECT_THROW(DatasetSequenceWriter(other.path, "kitti", sensors, times_s, false), UsageError);
    ScratchFolder third;
    EXPECT_THROW(DatasetSequenceWriter(third.path, "custom", sensors, times_s, false), UsageError);
}

}  // namespace
}  // namespace relidar
