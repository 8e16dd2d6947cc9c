// SPDX-License-Identifier: Apache-2.0
// Frames 2350 to 2352 of drive 0000, of which part kd1 of the paper starts at 2351. The
// car drives a curve in closed form, so that the exact pose is known at any time.
#pragma once

#include "read/datasets/kitti/kitti_drive.hpp"

namespace relidar::test {

struct Kitti360Folder : LogFolder {
    static constexpr int kFirst = 2350, kFrames = 3;
    static constexpr double kPeriod_s = 0.1;
    static constexpr const char* kDrive = "2013_05_28_drive_0000_sync";

    KittiDrive sweeps;

    /// @param first frame number of the first sweep
    explicit Kitti360Folder(const std::string& name, int first = kFirst);

    std::filesystem::path raw(const std::string& drive = kDrive) const {
        return folder / "data_3d_raw" / drive / "velodyne_points";
    }
    std::filesystem::path scan(int frame) const;
    std::filesystem::path poses() const { return folder / "data_poses" / kDrive / "poses.txt"; }
    std::filesystem::path boxes() const {
        return folder / "data_3d_bboxes/train_full" / (std::string(kDrive) + ".xml");
    }
    std::filesystem::path calibration(const std::string& file) const { return folder / "calibration" / file; }

    /// @param frame a fractional number is a time between two sweeps
    static glm::dmat4 compute_world_from_imu(double frame);
    static glm::dmat4 compute_world_from_velo(double frame);

    void write_poses(const std::vector<int>& frames) const;
};

/// As in KITTI-360, the matrix contains the rotation and the size.
glm::dmat4 make_box_matrix(const glm::dvec3& centre_m, double yaw_rad, const glm::dvec3& size_m);

/// The format is that of OpenCV's FileStorage. The transform applies to the unit cube.
std::string make_object_xml(int number, const std::string& fields, const glm::dmat4& transform);
/// @param timestamp frame of the label; -1 if the object does not move until end_frame
std::string make_object_fields(const std::string& label, int semantic, int instance, int timestamp,
                               int start_frame, int end_frame);
std::string make_boxes_xml(const std::string& objects);

}  // namespace relidar::test
