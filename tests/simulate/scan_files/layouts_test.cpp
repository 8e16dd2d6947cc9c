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
#include <relidar/simulate/dataset_layouts.hpp>

#include "base/codecs/npy.hpp"
#include "log/classes/dataset_classes.hpp"
#include "simulate/scan_files/layouts/layout.hpp"
#include "support/names.hpp"
#include "two_boxes.hpp"

namespace relidar {
namespace {

using namespace two_boxes;

/// A camera at the origin of the rig that looks forward.
Camera forward_camera() {
    return {"forward", 100.0, 100.0, 100.0, 80.0, 201, 161, {glm::dquat(0.5, -0.5, 0.5, -0.5), {}}};
}

void expect_box(const std::optional<layouts::ImageBox>& box, const std::array<double, 4>& expected_px,
                double truncated) {
    ASSERT_TRUE(box);
    const std::array found_px{box->min_px.x, box->min_px.y, box->max_px.x, box->max_px.y};
    for (std::size_t i = 0; i < 4; ++i) EXPECT_NEAR(found_px[i], expected_px[i], 1e-3) << i;
    EXPECT_NEAR(box->truncated, truncated, 1e-9);
}

TEST(ImageBox, HasTheCornersOfTheBoxInFrontOfTheCamera) {
    const Camera camera = forward_camera();
    const auto project = [&](const glm::dvec3& centre_m, const glm::dvec3& size_m) {
        return layouts::project_box(camera, {glm::dquat(1, 0, 0, 0), centre_m}, size_m);
    };
    expect_box(project({0, 0, 5}, {2, 2, 2}), {75, 55, 125, 105}, 0.0);
    expect_box(project({-5, 1, 5}, {2, 2, 0}), {0, 80, 20, 120}, 0.5);      // symmetric to column 0
    expect_box(project({5, 4, 5}, {2, 2, 0}), {180, 140, 200, 160}, 0.75);  // in a corner
    // Beside the camera, from 2 m behind to 2 m before it. Only 1.9 m are in front of the
    // near plane at 0.1 m, where the box reaches to column 3100 and row 1580.
    const double share = 1.0 - 50.0 * 55.0 / (2950.0 * 1475.0);
    expect_box(project({2, 1, 0}, {2, 1, 4}), {150, 105, 200, 160}, share);
    EXPECT_FALSE(project({0, 0, -5}, {2, 2, 2})) << "behind the camera";
    EXPECT_FALSE(project({-8, 0, 5}, {2, 2, 2})) << "left of the picture";
}

/// Reads a label: its type, and all numbers.
struct Label {
    std::string type;
    std::vector<double> v;
};
std::vector<Label> read_labels(const std::filesystem::path& file) {
    std::istringstream lines(read_contents(file));
    std::vector<Label> labels;
    for (std::string line; std::getline(lines, line);) {
        std::istringstream words(line);
        Label& label = labels.emplace_back();
        words >> label.type;
        for (double number; words >> number;) label.v.push_back(number);
    }
    return labels;
}

TEST_F(Layouts, KittiLabelsHaveTheClosedFormInTheCamera) {
    sensors.resize(1);
    view.camera = forward_camera();
    write_sequence("kitti", 0);
    const std::vector<Label> labels = read_labels(folder / "training/label_2/000001.txt");
    ASSERT_EQ(labels.size(), 2u);
    ASSERT_EQ(labels[0].v.size(), 14u);
    const std::vector<double>& v = labels[0].v;
    EXPECT_EQ(labels[0].type, "Car");
    EXPECT_EQ(v[0], 0.0) << "truncated";
    EXPECT_EQ(v[1], 1.0) << "three quarters are visible";
    const double turn = -kYaw - 0.5 * kPi,
                 expected[] = {kCarSize_m.z, kCarSize_m.y, kCarSize_m.x, -2.0, kRigHeight_m, 10.0};
    for (std::size_t i = 0; i < 6; ++i) EXPECT_NEAR(v[7 + i], expected[i], 1e-4) << i;
    EXPECT_NEAR(v[13], turn, 1e-4);
    EXPECT_NEAR(v[2], turn - std::atan2(-2.0, 10.0), 1e-4) << "alpha";
    // In the frame of the car, the corner nearest to the camera is 2 m behind the centre
    // and 1 m to the left.
    const double nearest_m = 10.0 - 2.0 * std::cos(kYaw) - std::sin(kYaw);
    EXPECT_NEAR(v[6], 80.0 + 100.0 * kRigHeight_m / nearest_m, 0.005) << "lowest row";
    EXPECT_EQ(labels[1].type, "Pedestrian");
    // Seen from the rig, the walker is symmetric to an azimuth of 45 degrees, column 0.
    const double half_width_rad = std::atan(0.3 / (4.0 * std::sqrt(2.0) - 0.3)),
                 left_px = 100.0 * std::tan(0.25 * kPi + half_width_rad) - 100.0,
                 right_px = 100.0 - 100.0 * std::tan(0.25 * kPi - half_width_rad);
    EXPECT_EQ(labels[1].v[3], 0.0);
    EXPECT_NEAR(labels[1].v[5], right_px, 0.005);
    EXPECT_NEAR(labels[1].v[0], left_px / (left_px + right_px), 0.005) << "truncated";
    EXPECT_EQ(labels[1].v[1], 2.0) << "a third is visible";
}

TEST_F(Layouts, ExtentOfAFrameIsThePictureOrTheLabelledSector) {
    sensors.resize(1);
    // No ray hits this car, so it may be anywhere behind others.
    sensors[0].options.actors.push_back({"hidden", "Car", kCarSize_m, {}});
    for (const double t : {kStart_s - 1.0, kStart_s + 3.0})
        sensors[0].options.actors.back().world_from_box.append(
            t, {glm::dquat(1, 0, 0, 0), rig_pose(t).translation + glm::dvec3(20.0, -3.0, 0.0)});
    LabelledSector sector{{-0.2, 0.5}, {}};
    for (const double t : times_s) sector.dataset_from_lidar.append(t, rig_pose(t));
    view.labelled = sector;
    const Camera kitti = kitti_camera();
    const auto count_outside = [&](std::size_t frame, const auto& is_inside) {
        const std::string bytes = read_contents(folder / fmt::format("training/velodyne/{:06}.bin", frame));
        std::size_t n_outside = 0;
        for (std::size_t at = 0; at < bytes.size(); at += 16) {
            glm::vec3 point;
            std::memcpy(&point, bytes.data() + at, sizeof point);
            n_outside += !is_inside(glm::dvec3(point));
        }
        return std::pair(n_outside, bytes.size() / 16);
    };
    const auto in_sector = [](const glm::dvec3& p) {
        return std::atan2(p.y, p.x) > -0.2001 && std::atan2(p.y, p.x) < 0.5001;
    };
    const auto in_picture = [&](const glm::dvec3& p) {
        const auto pixel = kitti.project(inverse(kitti.rig_from_camera) * p);
        return pixel && pixel->x > -0.01 && pixel->y > -0.01 && pixel->x < 1242.01 && pixel->y < 375.01;
    };
    std::size_t n_all = 0, frame = 0;
    for (const DatasetFov fov : {DatasetFov::all, DatasetFov::camera, DatasetFov::labels}) {
        view.fov = fov;
        write_sequence("kitti", 0);
        const std::vector<Label> labels =
            read_labels(folder / fmt::format("training/label_2/{:06}.txt", frame));
        const auto of_type = [&](const std::string& type) {
            return std::ranges::count(labels, type, &Label::type);
        };
        EXPECT_EQ(of_type("Car"), 1);
        EXPECT_EQ(of_type("Pedestrian"), fov == DatasetFov::all) << "at 45 degrees";
        // The hidden car, and the picture to the left and to the right of the sector.
        ASSERT_EQ(of_type("DontCare"), 3);
        const std::vector<Label> last(labels.end() - 3, labels.end());
        EXPECT_NEAR(last[0].v[3], last[0].v[5], 200.0);
        const double left_px = 609.56 - 721.54 * std::tan(0.5), right_px = 609.56 + 721.54 * std::tan(0.2);
        EXPECT_EQ(last[1].v[3], 0.0);
        EXPECT_NEAR(last[1].v[5], left_px, 2.0);
        EXPECT_NEAR(last[2].v[3], right_px, 2.0);
        EXPECT_EQ(last[2].v[5], 1241.0);
        EXPECT_EQ(last[2].v[6], 374.0);
        if (fov == DatasetFov::all) {
            for (std::size_t i = 3; i < 7; ++i) EXPECT_EQ(labels[1].v[i], 0.0) << "not in the picture";
        }
        const auto [n_outside_sector, n] = count_outside(frame, in_sector);
        EXPECT_EQ(n_outside_sector == 0, fov == DatasetFov::labels);
        EXPECT_EQ(count_outside(frame, in_picture).first == 0, fov == DatasetFov::camera);
        if (fov == DatasetFov::all) n_all = n;
        EXPECT_EQ(n < n_all, fov != DatasetFov::all);
        EXPECT_GT(n, n_all / 5);
        frame += kSequenceFrames;
    }
}

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

/// The loaders add half of the height along the z axis of the LiDAR.
TEST_F(Layouts, KittiLoadersFindTheCentreForATiltedSensor) {
    sensors.resize(1);
    sensors[0].rig_from_sensor = {glm::angleAxis(0.05, glm::dvec3(0, 1, 0)), glm::dvec3(0.0)};
    write_sequence("kitti", 0);
    std::istringstream label(read_contents(folder / "training/label_2/000000.txt"));
    std::string word;
    for (int i = 0; i < 8; ++i) label >> word;
    double height, width, length;
    glm::dvec3 location;
    label >> height >> width >> length >> location.x >> location.y >> location.z;
    std::istringstream calibration(read_contents(folder / "training/calib/000000.txt"));
    while (calibration >> word && word != "Tr_velo_to_cam:") {}
    double m[12];
    for (double& value : m) calibration >> value;
    const glm::dmat3 rig_from_camera(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);  // transposed
    const glm::dvec3 found = rig_from_camera * (location - glm::dvec3(m[3], m[7], m[11])) +
                             glm::dvec3(0.0, 0.0, 0.5 * height),
                     expected = sensors[0].rig_from_sensor * inverse(rig_pose(kStart_s)) *
                                car_pose(kStart_s).translation;
    EXPECT_LT(glm::distance(found, expected), 1e-3);
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
