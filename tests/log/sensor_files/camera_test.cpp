// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/camera.hpp>

#include <relidar/log/log.hpp>

#include "support/sensor_texts.hpp"

namespace relidar {
namespace {

using test::write;

template <class E, class Call>
std::string message(const Call& call) {
    try {
        call();
    } catch (const E& error) {
        return error.what();
    }
    return "";
}

constexpr const char* kFront = R"("K": [500, 0, 319.5, 0, 600, 239.5, 0, 0, 1], "size": [640, 480])";

TEST(CameraGeometry, ProjectionInvertsTheRays) {
    for (const Camera& camera :
         {kitti_camera(), nuscenes_camera(), parse_camera(std::string("{") + kFront + "}", "a")})
        for (const glm::dvec2 pixel :
             {glm::dvec2(0, 0), {17, 300.25}, {camera.columns - 1, camera.rows - 1}, {-90, 5}})
            for (const double range_m : {0.3, 7.0, 200.0}) {
                const auto projected = camera.project(range_m * camera.direction_of(pixel));
                ASSERT_TRUE(projected);
                EXPECT_LT(glm::distance(*projected, pixel), 1e-9);
                EXPECT_FALSE(camera.project(-range_m * camera.direction_of(pixel)));
            }
    const Camera camera = kitti_camera();
    EXPECT_FALSE(camera.project({1.0, 1.0, 0.0}));
    EXPECT_TRUE(camera.contains({-0.5, 374.4}));
    EXPECT_FALSE(camera.contains({0.0, 374.5}));
    EXPECT_FALSE(camera.contains({-0.6, 0.0}));
}

// Pixels are P2 * R0_rect * Tr_velo_to_cam * point, with KITTI's files of 2011-09-26,
// computed with numpy.
TEST(CameraGeometry, KittiProjectsAsItsCalibrationFiles) {
    const Camera camera = kitti_camera();
    const auto pixel_of = [&](const glm::dvec3& velodyne_m) {
        return camera.project(inverse(camera.rig_from_camera) * velodyne_m).value();
    };
    EXPECT_EQ(camera.columns, 1242);
    EXPECT_EQ(camera.rows, 375);
    EXPECT_LT(glm::distance(pixel_of({5, 0, -1.5}), glm::dvec2(620.8953, 398.8369)), 0.01);
    EXPECT_LT(glm::distance(pixel_of({12, 4, -1}), glm::dvec2(367.6507, 240.0873)), 0.01);
    EXPECT_LT(glm::distance(pixel_of({30, -9, 2}), glm::dvec2(828.8787, 127.8172)), 0.01);
    EXPECT_LT(glm::distance(pixel_of({70, 20, 0.5}), glm::dvec2(403.3381, 176.6550)), 0.01);
}

TEST(CameraGeometry, NuscenesLooksForwardFromTheRoof) {
    const Camera camera = nuscenes_camera();
    // A point 20 m ahead of the LiDAR is 19.24 m ahead of the camera and 0.33 m above it.
    const glm::dvec2 pixel =
        camera.project(inverse(camera.rig_from_camera) * glm::dvec3(20.0, 0.0, 0.0)).value();
    EXPECT_NEAR(pixel.x, 816.27, 60.0);
    EXPECT_NEAR(pixel.y, 491.5 - 1266.4 * 0.33 / 19.24, 30.0);
    EXPECT_LT(glm::distance(camera.rig_from_camera.translation, glm::dvec3(0.757, 0.0, -0.33)), 0.03);
}

TEST(CameraFiles, MountingsAreThoseOfRigs) {
    const auto parse = [](const std::string& mounting) {
        return parse_camera("{" + (kFront + mounting) + "}", "a");
    };
    const Camera forward = parse(R"(, "name": "front", "translation_m": [1, 2, 3])");
    EXPECT_EQ(forward.name, "front");
    EXPECT_EQ(forward.columns, 640);
    EXPECT_EQ(forward.rows, 480);
    EXPECT_EQ(forward.focal_x_px, 500.0);
    EXPECT_EQ(forward.focal_y_px, 600.0);
    EXPECT_LT(glm::distance(forward.rig_from_camera * glm::dvec3(0.1, 0.2, 5.0), glm::dvec3(6.0, 1.9, 2.8)),
              1e-12);
    const Camera left = parse(R"(, "yaw_pitch_roll_deg": [90, 0, 0])");
    EXPECT_LT(glm::distance(left.rig_from_camera * glm::dvec3(0.1, 0.2, 5.0), glm::dvec3(0.1, 5.0, -0.2)),
              1e-12);
    const Camera same = parse(R"(, "quaternion": [0.5, -0.5, 0.5, -0.5], "translation_m": [1, 2, 3])");
    EXPECT_LT(glm::distance(same.rig_from_camera * glm::dvec3(0.1, 0.2, 5.0), glm::dvec3(6.0, 1.9, 2.8)),
              1e-12);
    EXPECT_EQ(
        parse_camera(R"({"K": [[500, 0, 3], [0, 600, 4], [0, 0, 1]], "size": [7, 8]})", "a").centre_y_px,
        4.0);
}

TEST(CameraFiles, ErrorsNameTheKey) {
    const auto expect_error = [](const std::string& text, const std::string& key, const std::string& found) {
        const std::string error = message<DataError>([&] { parse_camera(text, "cam.json"); });
        EXPECT_TRUE(error.starts_with("cam.json: ")) << error;
        EXPECT_NE(error.find(key), std::string::npos) << error;
        EXPECT_NE(error.find(found), std::string::npos) << error;
        EXPECT_EQ(error.find('\n'), std::string::npos) << error;
    };
    const std::string front = kFront;
    expect_error("{\"size\": [640, 480]}", "K", "missing");
    expect_error(R"({"K": [1, 0, 1], "size": [640, 480]})", "K", "3 numbers");
    expect_error(R"({"K": [0, 0, 1, 0, 1, 1, 0, 0, 1], "size": [640, 480]})", "K", "focal length 0");
    expect_error(R"({"K": [1, 0.1, 1, 0, 1, 1, 0, 0, 1], "size": [640, 480]})", "K", "another matrix");
    expect_error(R"({"K": [1, 0, 1, 0, 1, 1, 0, 0, 1], "size": [640]})", "size", "1 number");
    expect_error(R"({"K": [1, 0, 1, 0, 1, 1, 0, 0, 1], "size": [640, 0]})", "size[1]", "0");
    expect_error("{" + front + R"(, "quaternion": [1, 1, 0, 0]})", "quaternion", "1.41");
    expect_error("{" + front + R"(, "quaternion": [1, 0, 0, 0], "yaw_pitch_roll_deg": [0, 0, 0]})",
                 "quaternion", "yaw");
    expect_error("{" + front + R"(, "translation": [0, 0, 0]})", "translation", "translation_m");
    expect_error("[]", "", "");
}

TEST(CameraFiles, NamesSelectCamerasOfTheLogFirst) {
    Log log;
    log.lidars.resize(2);
    log.lidars[1].vehicle_from_sensor.translation = {1.0, 0.0, 0.0};
    log.cameras = {kitti_camera()};
    log.cameras[0].name = "image_2";
    EXPECT_EQ(choose_camera("IMAGE_2", log).columns, 1242);
    EXPECT_NEAR(choose_camera("image_2", log, 1).rig_from_camera.translation.x,
                kitti_camera().rig_from_camera.translation.x - 1.0, 1e-12);
    EXPECT_EQ(choose_camera("nuscenes", log, 1).rig_from_camera.translation,
              nuscenes_camera().rig_from_camera.translation);
    EXPECT_EQ(choose_camera(write("cam.json", std::string("{") + kFront + "}"), log).rows, 480);
    const std::string error = message<UsageError>([&] { choose_camera("kiti", log); });
    EXPECT_NE(error.find("kitti"), std::string::npos);
    EXPECT_NE(error.find("image_2"), std::string::npos);
}

}  // namespace
}  // namespace relidar
