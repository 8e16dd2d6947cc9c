// SPDX-License-Identifier: Apache-2.0
// Tests the layouts that only loaders of other projects read, on exact scans: tables,
// scenes, cameras and categories of nuScenes, and custom data sets.

#include <array>
#include <cstring>
#include <fstream>
#include <set>
#include <sstream>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <nlohmann/json.hpp>

#include <relidar/read/dataset.hpp>
#include <relidar/simulate/dataset_layouts.hpp>

#include "base/codecs/npy.hpp"
#include "simulate/scan_files/layouts/layout.hpp"
#include "two_boxes.hpp"

namespace relidar {
namespace {

using namespace two_boxes;

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
    view.camera = Camera{.name = "front",
                         .focal_x_px = 500.0,
                         .focal_y_px = 510.0,
                         .centre_x_px = 330.0,
                         .centre_y_px = 170.0,
                         .columns = 640,
                         .rows = 360,
                         .rig_from_camera = {glm::dquat(0.5, -0.5, 0.5, -0.5), {0.3, 0.1, -0.2}}};
    for (DatasetSensor& sensor : sensors)
        sensor.options.vehicle_from_lidar = {glm::angleAxis(0.3, glm::dvec3(0, 0, 1)), {1.0, 0.2, 1.5}};
    RenderedScan picture;
    picture.image.rows = 360;
    picture.image.columns = 640;
    picture.image.range_m.assign(640 * 360, 5.0f);
    picture = test::complete(std::move(picture));
    write_sequence("nuscenes", 0);
    write_sequence("nuscenes", 1, false, &picture);
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

}  // namespace
}  // namespace relidar
