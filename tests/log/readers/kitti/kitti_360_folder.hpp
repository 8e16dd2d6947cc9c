// SPDX-License-Identifier: Apache-2.0
// A small KITTI-360 written by the tests: the sweeps of the virtual HDL-64E as frames
// 2350 to 2352 of drive 0000, which is in its paper's part kd1 from 2351 on. The car
// drives an even curve, so that where the LiDAR was at any time is known.
#pragma once

#include <filesystem>
#include <string>

#include <glm/glm.hpp>

#include "log/readers/kitti/kitti_drive.hpp"

namespace relidar::test {

struct Kitti360Folder {
    static constexpr int kFirst = 2350, kFrames = 3;
    static constexpr double kPeriod_s = 0.1;
    static constexpr const char* kDrive = "2013_05_28_drive_0000_sync";

    KittiDrive sweeps;
    std::filesystem::path folder;

    /// @param first  frame number of the first sweep
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

    /// Truth, in the dataset's world. @param frame  with a fraction: between two sweeps
    static glm::dmat4 world_from_imu(double frame);
    static glm::dmat4 world_from_velo(double frame);

    /// poses.txt with some of the frames.
    void write_poses(const std::vector<int>& frames) const;
};

/// A box of the labels: rotation and size in one matrix, as KITTI-360 has them.
glm::dmat4 box_matrix(const glm::dvec3& centre_m, double yaw_rad, const glm::dvec3& size_m);

/// A child of opencv_storage with these fields, its transform, and the cube that the
/// transform is of.
std::string object_xml(int number, const std::string& fields, const glm::dmat4& transform);
/// Fields of an object of train_full, drive 0004 excepted. @param timestamp  -1: it
/// stands, over start_frame to end_frame
std::string object_fields(const std::string& label, int semantic, int instance, int timestamp,
                          int start_frame, int end_frame);
std::string boxes_xml(const std::string& objects);

}  // namespace relidar::test
