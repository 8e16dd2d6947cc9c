// SPDX-License-Identifier: Apache-2.0
// Matrices are 4x4 products, independently of the library.
#include "read/datasets/kitti/kitti_360_folder.hpp"

#include <fmt/format.h>
#include <glm/gtc/matrix_transform.hpp>

namespace relidar::test {
namespace fs = std::filesystem;
namespace {

glm::dmat4 make_frame_matrix(const glm::dvec3& x, const glm::dvec3& y, const glm::dvec3& z,
                             const glm::dvec3& translation) {
    return {glm::dvec4(x, 0), glm::dvec4(y, 0), glm::dvec4(z, 0), glm::dvec4(translation, 1)};
}

/// The camera looks along x of the IMU, and its y is z of the IMU, with a small tilt.
glm::dmat4 get_imu_from_cam0() {
    return glm::rotate(make_frame_matrix({0, 1, 0}, {0, 0, 1}, {1, 0, 0}, {1.57, 0.04, -0.9}), 0.03,
                       glm::dvec3(1, 0, 0));
}

glm::dmat4 get_velo_from_cam0() {
    return glm::rotate(make_frame_matrix({0, -1, 0}, {0, 0, -1}, {1, 0, 0}, {0.81, 0.28, -0.1}), -0.02,
                       {0, 1, 0});
}

std::string numbers(const glm::dmat4& matrix) {
    std::string text;
    for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 4; ++c) text += fmt::format("{}{:.12g}", text.empty() ? "" : " ", matrix[c][r]);
    return text;
}

std::string make_timestamps(int n_frames) {
    std::string text;
    for (int frame = 0; frame < n_frames; ++frame) {
        const int ms = 904 + 100 * frame, minute = 46 + ms / 60000;
        text += fmt::format("2013-05-28 08:{:02d}:{:02d}.{:03d}000000\n", minute, ms / 1000 % 60, ms % 1000);
    }
    return text;
}

}  // namespace

glm::dmat4 make_box_matrix(const glm::dvec3& centre_m, double yaw_rad, const glm::dvec3& size_m) {
    return glm::scale(glm::rotate(glm::translate(glm::dmat4(1.0), centre_m), yaw_rad, glm::dvec3(0, 0, 1)),
                      size_m);
}

std::string make_object_xml(int number, const std::string& fields, const glm::dmat4& transform) {
    std::string data;
    for (int i = 0; i < 16; ++i)
        data += fmt::format("{}{:.16e}", i % 2 == 0 ? "\n      " : " ", transform[i % 4][i / 4]);
    return fmt::format(
        "<object{0}>\n{1}  <transform type_id=\"opencv-matrix\">\n    <rows>4</rows>\n    <cols>4</cols>\n   "
        " "
        "<dt>d</dt>\n    <data>{2}</data></transform>\n</object{0}>\n",
        number, fields, data);
}

std::string make_object_fields(const std::string& label, int semantic, int instance, int timestamp,
                               int start_frame, int end_frame) {
    return fmt::format(
        "  <index>{2}</index>\n  <label>{0}</label>\n  <semanticId_orig>0</semanticId_orig>\n  "
        "<semanticId>{1}</semanticId>\n"
        "  <instanceId>{2}</instanceId>\n  <category>object</category>\n  <timestamp>{3}</timestamp>\n  "
        "<dynamic>{4}</dynamic>\n"
        "  <start_frame>{5}</start_frame>\n  <end_frame>{6}</end_frame>\n",
        label, semantic, instance, timestamp, timestamp >= 0 ? 1 : 0, start_frame, end_frame);
}

std::string make_boxes_xml(const std::string& objects) {
    return "<?xml version=\"1.0\"?>\n<opencv_storage>\n" + objects + "</opencv_storage>\n";
}

glm::dmat4 Kitti360Folder::compute_world_from_imu(double frame) {
    const double s = frame - kFirst;
    const glm::dmat4 heading =
        glm::rotate(glm::translate(glm::dmat4(1.0), {1254.5 + 0.9 * s, 3811.25 - 0.4 * s, 114.0 + 0.01 * s}),
                    -0.4 + 0.02 * s, glm::dvec3(0, 0, 1));
    return glm::rotate(glm::rotate(heading, 0.01, glm::dvec3(0, 1, 0)), glm::pi<double>(),
                       glm::dvec3(1, 0, 0));  // z down
}

glm::dmat4 Kitti360Folder::compute_world_from_velo(double frame) {
    return compute_world_from_imu(frame) * get_imu_from_cam0() * glm::inverse(get_velo_from_cam0());
}

fs::path Kitti360Folder::scan(int frame) const { return raw() / "data" / fmt::format("{:010d}.bin", frame); }

void Kitti360Folder::write_poses(const std::vector<int>& frames) const {
    std::string text;
    for (const int frame : frames)
        text += fmt::format("{} {} \n", frame, numbers(compute_world_from_imu(frame)));
    write_text(poses(), text);
}

Kitti360Folder::Kitti360Folder(const std::string& name, int first)
    : LogFolder("relidar_" + name, "KITTI-360"), sweeps(name + "_sweeps") {
    for (int frame = 0; frame < kFrames; ++frame)
        write_text(scan(first + frame), read_text(sweeps.scan(frame)));
    write_text(raw() / "timestamps.txt", make_timestamps(first + 10));
    write_poses({first, first + 1, first + 2});
    std::string cameras;
    for (int camera = 0; camera < 4; ++camera)
        cameras += fmt::format("image_{:02d}: {}\n", camera, numbers(get_imu_from_cam0()));
    write_text(calibration("calib_cam_to_pose.txt"), cameras);
    write_text(calibration("calib_cam_to_velo.txt"), numbers(get_velo_from_cam0()) + "\n");
    // A car that drives ahead (mirrored in its second label), a parked car, a wall, and a
    // person without a position.
    std::string objects;
    for (int i = 0; i < kFrames; ++i) {
        const glm::dvec3 size = i == 1 ? glm::dvec3(6, -3, 2) : glm::dvec3(6, 3, 2);
        objects +=
            make_object_xml(i, make_object_fields("car", 13, 5, first + i, first, first + 2),
                            compute_world_from_velo(first + i) * make_box_matrix({9.5, 0, 0}, 0.3, size));
    }
    objects +=
        make_object_xml(3, make_object_fields("car", 13, 7, -1, first + 1, first + 50),
                        compute_world_from_velo(first + 1) * make_box_matrix({0, 9, 0}, 1.2, {8, 4, 2}));
    objects += make_object_xml(4, make_object_fields("building", 11, 1, -1, 0, 9999), glm::dmat4(0.0));
    objects += "<object5>\n" + make_object_fields("pedestrian", 19, 2, -1, 0, 9999) + "</object5>\n";
    write_text(boxes(), make_boxes_xml(objects));
}

}  // namespace relidar::test
