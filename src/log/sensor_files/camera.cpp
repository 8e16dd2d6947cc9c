// SPDX-License-Identifier: Apache-2.0
// Geometry of pinhole cameras, the built-in cameras, and cameras in JSON files.
#include <relidar/log/camera.hpp>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <relidar/log/log.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "log/sensor_files/camera_json.hpp"

namespace relidar {
namespace {

constexpr std::int64_t kMaxSide_px = 16384;
constexpr double kMaxFocal_px = 1e6, kMaxMounting_m = 1000.0;

/// Rotation to a frame with x forward, y left, z up from one with x right, y down, z
/// forward.
const glm::dquat kForwardFromCamera(0.5, -0.5, 0.5, -0.5);

/// Reads focal lengths and centre from K, as nine numbers or three rows of three.
void parse_matrix(const JsonField& field, Camera& camera) {
    const std::vector<double> k = field.flat_numbers(2);
    if (k.size() != 9) field.reject(fmt::format("found {} numbers", k.size()), "expected 9");
    if (k[1] != 0.0 || k[3] != 0.0 || k[6] != 0.0 || k[7] != 0.0 || k[8] != 1.0)
        field.reject("found another matrix", "expected fx, 0, cx, 0, fy, cy, 0, 0, 1");
    for (const std::size_t i : {0, 4})
        if (!(k[i] > 0.0 && k[i] <= kMaxFocal_px))
            field.reject(fmt::format("found the focal length {}", k[i]),
                         fmt::format("expected pixels above 0 and up to {:.0f}", kMaxFocal_px));
    camera.focal_x_px = k[0];
    camera.centre_x_px = k[2];
    camera.focal_y_px = k[4];
    camera.centre_y_px = k[5];
}

/// Reads the rotation from the frame of the camera to the frame of the rig.
glm::dquat parse_rotation(const JsonField& root) {
    if (root.has_member("quaternion")) {
        const JsonField field = root.at("quaternion");
        const auto q = field.numbers<4>();
        const glm::dquat rotation(q[0], q[1], q[2], q[3]);
        if (root.has_member("yaw_pitch_roll_deg"))
            field.reject("found yaw_pitch_roll_deg, too", "expected one of them");
        if (std::abs(glm::length(rotation) - 1.0) > 1e-3)
            field.reject(fmt::format("found the length {}", glm::length(rotation)), "expected length 1");
        // Does not change the last digits of a quaternion that camera_json() has written.
        return std::abs(glm::length(rotation) - 1.0) < 1e-12 ? rotation : glm::normalize(rotation);
    }
    if (!root.has_member("yaw_pitch_roll_deg")) return kForwardFromCamera;
    const glm::dvec3 angle_rad = root.at("yaw_pitch_roll_deg").vector_in(-360.0, 360.0) * (kPi / 180.0);
    return make_rotation(angle_rad.x, angle_rad.y, angle_rad.z) * kForwardFromCamera;
}

}  // namespace

std::optional<glm::dvec2> Camera::project(const glm::dvec3& point_m) const {
    if (!(point_m.z > 0.0)) return {};
    return glm::dvec2(centre_x_px + focal_x_px * point_m.x / point_m.z,
                      centre_y_px + focal_y_px * point_m.y / point_m.z);
}

glm::dvec3 Camera::direction_of(const glm::dvec2& pixel) const {
    return glm::normalize(
        glm::dvec3((pixel.x - centre_x_px) / focal_x_px, (pixel.y - centre_y_px) / focal_y_px, 1.0));
}

bool Camera::contains(const glm::dvec2& pixel) const {
    return pixel.x >= -0.5 && pixel.y >= -0.5 && pixel.x < columns - 0.5 && pixel.y < rows - 0.5;
}

Camera make_camera(const std::string& name, const std::array<double, 12>& projection,
                   const Pose& rectified_from_rig) {
    const double fx = projection[0], cx = projection[2], fy = projection[5], cy = projection[6];
    const double z_m = projection[11];
    const glm::dvec3 camera_rectified_m((projection[3] - cx * z_m) / fx, (projection[7] - cy * z_m) / fy,
                                        z_m);
    Camera camera{name, fx, fy, cx, cy};
    camera.rig_from_camera =
        inverse(Pose{glm::dquat(1.0, 0.0, 0.0, 0.0), camera_rectified_m} * rectified_from_rig);
    return camera;
}

// P_rect_02, R_rect_00 and the transform of calib_velo_to_cam.txt.
Camera kitti_camera() {
    const glm::dmat3 rectified_from_cam0 =
        glm::transpose(glm::dmat3(9.999239e-01, 9.837760e-03, -7.445048e-03, -9.869795e-03, 9.999421e-01,
                                  -4.278459e-03, 7.402527e-03, 4.351614e-03, 9.999631e-01));
    const glm::dmat3 cam0_from_velo =
        glm::transpose(glm::dmat3(7.533745e-03, -9.999714e-01, -6.166020e-04, 1.480249e-02, 7.280733e-04,
                                  -9.998902e-01, 9.998621e-01, 7.523790e-03, 1.480755e-02));
    const glm::dvec3 cam0_velo_m(-4.069766e-03, -7.631618e-02, -2.717806e-01);
    Camera camera = make_camera(
        "kitti",
        {721.5377, 0.0, 609.5593, 44.85728, 0.0, 721.5377, 172.854, 0.2163791, 0.0, 0.0, 1.0, 2.745884e-03},
        {glm::normalize(glm::quat_cast(rectified_from_cam0 * cam0_from_velo)),
         rectified_from_cam0 * cam0_velo_m});
    camera.columns = 1242;
    camera.rows = 375;
    return camera;
}

// From the calibration of log n015-2018-07-24. In nuScenes' files, the LiDAR's x points
// to the right and y forward.
Camera nuscenes_camera() {
    const Pose ego_from_camera{glm::normalize(glm::dquat(0.4998015, -0.5030316, 0.4997798, -0.4973737)),
                               {1.70079119, 0.01594563, 1.51095764}};
    const Pose ego_from_lidar{glm::normalize(glm::dquat(0.7077955, -0.0064922, 0.0106463, -0.7063073)),
                              {0.943713, 0.0, 1.84023}};
    const Pose raw_from_lidar{make_rotation(0.5 * kPi, 0.0, 0.0), {}};
    return {"nuscenes", 1266.4172, 1266.4172, 816.26702,
            491.50707,  1600,      900,       inverse(ego_from_lidar * raw_from_lidar) * ego_from_camera};
}

nlohmann::ordered_json camera_json(const Camera& camera) {
    const glm::dvec3& t = camera.rig_from_camera.translation;
    const glm::dquat& q = camera.rig_from_camera.rotation;
    return {{"name", camera.name},
            {"K",
             {camera.focal_x_px, 0.0, camera.centre_x_px, 0.0, camera.focal_y_px, camera.centre_y_px, 0.0,
              0.0, 1.0}},
            {"size", {camera.columns, camera.rows}},
            {"translation_m", {t.x, t.y, t.z}},
            {"quaternion", {q.w, q.x, q.y, q.z}}};
}

Camera read_camera(const JsonField& root) {
    root.check_members({"name", "K", "size", "translation_m", "yaw_pitch_roll_deg", "quaternion"});
    Camera camera{.name = root.has_member("name") ? root.at("name").short_text(64) : "camera"};
    parse_matrix(root.at("K"), camera);
    const JsonField size = root.at("size");
    if (size.size() != 2) size.reject(fmt::format("found {} numbers", size.size()), "expected columns, rows");
    camera.columns = int(size.at(0).integer_in(1, kMaxSide_px));
    camera.rows = int(size.at(1).integer_in(1, kMaxSide_px));
    camera.rig_from_camera.rotation = parse_rotation(root);
    if (root.has_member("translation_m"))
        camera.rig_from_camera.translation =
            root.at("translation_m").vector_in(-kMaxMounting_m, kMaxMounting_m);
    return camera;
}

Camera parse_camera(const std::string& text, const std::string& where) {
    const nlohmann::json json = parse_json(text, where);
    return read_camera(JsonField(json, where, ""));
}

Camera choose_camera(const std::string& name_or_file, const Log& log, int lidar) {
    std::vector<Camera> cameras = log.cameras;
    const Pose lidar_from_first =
        inverse(log.lidars[std::size_t(lidar)].vehicle_from_sensor) * log.lidars.front().vehicle_from_sensor;
    for (Camera& camera : cameras) camera.rig_from_camera = lidar_from_first * camera.rig_from_camera;
    cameras.push_back(kitti_camera());
    cameras.push_back(nuscenes_camera());
    std::vector<std::string> names;
    for (const Camera& camera : cameras) names.push_back(camera.name);
    if (const auto name = find_name(name_or_file, names))
        return *std::ranges::find(cameras, *name, &Camera::name);
    if (std::filesystem::path(name_or_file).extension() == ".json" || does_path_exist(name_or_file))
        return parse_camera(read_text_file(name_or_file), name_or_file);
    fail<UsageError>("the camera '{}' is unknown{} (known: {}; or the path of a JSON file)", name_or_file,
                     did_you_mean(name_or_file, names, "'"), fmt::join(names, ", "));
}

}  // namespace relidar
