// SPDX-License-Identifier: Apache-2.0
// Compares labels and points of the layout kitti with closed forms.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <sstream>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "layouts_fixture.hpp"

namespace relidar {
namespace {

using namespace test;

/// A camera at the origin of the rig that looks forward.
Camera forward_camera() {
    return {"forward", 100.0, 100.0, 100.0, 80.0, 201, 161, {glm::dquat(0.5, -0.5, 0.5, -0.5), {}}};
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
    write_sequence("kitti", 0, false, {.camera = forward_camera()});
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
        write_sequence("kitti", 0, false, {.fov = fov, .labelled = sector});
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

}  // namespace
}  // namespace relidar
