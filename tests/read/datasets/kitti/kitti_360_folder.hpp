// SPDX-License-Identifier: Apache-2.0
// Writes a small KITTI-360 folder: sweeps of the virtual HDL-64E as frames 2350 to 2352
// of drive 0000. From frame 2351 on, this drive belongs to part kd1 of the paper. The car
// drives a smooth curve in closed form, so that the exact pose of the LiDAR can be
// computed at any time.
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

    /// Returns the exact pose in the dataset's world.
    /// @param frame frame number. A fractional number is a time between two sweeps.
    static glm::dmat4 compute_world_from_imu(double frame);
    static glm::dmat4 compute_world_from_velo(double frame);

    /// Writes poses.txt with the given frames.
    void write_poses(const std::vector<int>& frames) const;
};

/// Returns the matrix of a labelled box. As in KITTI-360, it contains the rotation and
/// the size.
glm::dmat4 make_box_matrix(const glm::dvec3& centre_m, double yaw_rad, const glm::dvec3& size_m);

/// Returns an XML child of opencv_storage with the fields of an object, its transform,
/// and the unit cube to which the transform applies.
std::string make_object_xml(int number, const std::string& fields, const glm::dmat4& transform);
/// Returns the fields of an object in train_full, for drives other than 0004.
/// @param timestamp frame of the label. -1 means that the object does not move from
/// start_frame to end_frame.
std::string make_object_fields(const std::string& label, int semantic, int instance, int timestamp,
                               int start_frame, int end_frame);
std::string make_boxes_xml(const std::string& objects);

}  // namespace relidar::test
