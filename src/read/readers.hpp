// SPDX-License-Identifier: Apache-2.0
// Loads a log of each dataset, for registry.cpp. All functions throw a DataError with the
// file and the field, line, record or message. They throw a UsageError if
// DatasetOptions::sequence is unknown or no scan is in the requested frame range.
#pragma once

#include <filesystem>

#include <relidar/read/dataset.hpp>

namespace relidar {

/// Loads an Argoverse 2 log. Frames are numbered in the order of the sweeps. Both LiDARs
/// of a sweep share number and time. The world frame is the city frame of the dataset.
Log load_argoverse2(const std::filesystem::path& folder, const DatasetOptions& options);

/// Loads a sequence of the Boreas dataset. Frames are sorted by time. The vehicle frame
/// is the LiDAR frame, rotated so that x points forward. The world frame is
/// East-North-Up.
Log load_boreas(const std::filesystem::path& folder, const DatasetOptions& options);

/// Loads the requested frames of a KITTI raw drive.
/// @param drive  folder that contains velodyne_points
Log load_kitti_raw(const std::filesystem::path& drive, const DatasetOptions& options);

/// Loads a KITTI odometry sequence. Its scans are motion-compensated, so all rays of a
/// scan have the same sensor pose. The world frame is the LiDAR frame in frame 0.
Log load_odometry(const std::filesystem::path& folder, const DatasetOptions& options);

/// Loads one drive of KITTI-360. DatasetOptions::sequence is the name of the drive's
/// folder, or the four digits in this name. It can also be a sequence name of the
/// LiDAR-RT paper (ks1 to ks4, kd1 to kd6), which means a part of drive 0000. The world
/// frame has x east, y north and z up.
/// @param folder  folder that contains data_3d_raw
Log load_kitti_360(const std::filesystem::path& folder, const DatasetOptions& options);

/// Loads a MulRan sequence. Frames are sorted by time. The vehicle frame and the world
/// frame are those of global_pose.csv.
Log load_mulran(const std::filesystem::path& folder, const DatasetOptions& options);

/// Loads a sequence of NCore v4. Frames are the sweeps of the first LiDAR by name, and
/// simultaneous sweeps of other LiDARs. The world frame is the frame "world" of the
/// sequence.
/// @param path  a store (*.zarr.itar or a folder *.zarr), or a folder of stores
Log load_ncore(const std::filesystem::path& path, const DatasetOptions& options);

/// Loads the scene that DatasetOptions::sequence selects: by its name ("scene-0061"), by
/// its first characters, or by its number ("61"). The frames are the keyframes and sweeps
/// of the first LiDAR, sorted by time. Sweeps of other LiDARs at nearly the same time get
/// the same frame number. The world frame is the frame of the dataset's poses.
Log load_nuscenes(const std::filesystem::path& folder, const DatasetOptions& options);

/// Loads a ONCE sequence. Frames are numbered in the order of the JSON file. The vehicle
/// frame is the LiDAR frame, rotated so that x points forward. The world frame is the
/// LiDAR frame in the first frame. Boxes are not loaded, because they have no track ids.
Log load_once(const std::filesystem::path& folder, const DatasetOptions& options);

/// Loads a log in relidar's format: a folder with sequence.json, poses.txt, boxes.json
/// and scans.
Log load_folder(const std::filesystem::path& folder, const DatasetOptions& options);

/// Loads a recording: rosbag2 in MCAP or SQLite, a ROS 1 bag, an MCAP file with ROS
/// messages from another recorder, or a network capture of LiDAR packets.
Log load_ros_bag(const std::filesystem::path& path, const DatasetOptions& options);

/// Generates the log that folder/street.toml describes. The origin of the world is the
/// sensor position in the middle of the full log, even if only some frames are loaded.
Log load_synthetic(const std::filesystem::path& folder, const DatasetOptions& options);

/// Loads a segment of Waymo Open. A frame number is the index of the record.
/// DatasetOptions::sequence selects a file by the first characters of its name, with or
/// without "segment-". Sequence names of the LiDAR-RT paper (ws1 to ws4, wd1 to wd4)
/// select a part of a segment with only the LiDAR TOP.
/// @param path  a .tfrecord file, or a folder of such files
Log load_waymo(const std::filesystem::path& path, const DatasetOptions& options);

}  // namespace relidar
