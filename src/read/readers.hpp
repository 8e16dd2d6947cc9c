// SPDX-License-Identifier: Apache-2.0
// Loads a log of each dataset, for registry.cpp. All functions throw a DataError with the
// file and the field, line or record. They throw a UsageError if DatasetOptions::sequence
// is unknown or no scan is in the requested frame range.
#pragma once

#include <filesystem>

#include <relidar/read/dataset.hpp>

namespace relidar {

/// Frames are numbered in the order of the sweeps. Both LiDARs of a sweep share number
/// and time. The world frame is the city frame of the dataset.
Log load_argoverse2(const std::filesystem::path& folder, const DatasetOptions& options);

/// Frames are sorted by time. The vehicle frame is the LiDAR frame, rotated so that x
/// points forward. The world frame is East-North-Up.
Log load_boreas(const std::filesystem::path& folder, const DatasetOptions& options);

/// @param drive  contains velodyne_points
Log load_kitti_raw(const std::filesystem::path& drive, const DatasetOptions& options);

/// The scans are motion-compensated, so all rays of a scan have the same sensor pose. The
/// world frame is the LiDAR frame in frame 0.
Log load_odometry(const std::filesystem::path& folder, const DatasetOptions& options);

/// DatasetOptions::sequence is the name of the folder of a drive, its four digits, or a
/// part of drive 0000 in the LiDAR-RT paper (ks1 to ks4, kd1 to kd6). The world frame has
/// x east, y north and z up.
/// @param folder  contains data_3d_raw
Log load_kitti_360(const std::filesystem::path& folder, const DatasetOptions& options);

/// Frames are sorted by time. Vehicle frame and world frame are those of global_pose.csv.
Log load_mulran(const std::filesystem::path& folder, const DatasetOptions& options);

/// DatasetOptions::sequence selects a scene by its name ("scene-0061"), by its first
/// characters, or by its number ("61"). Frames are the keyframes and sweeps of the first
/// LiDAR, sorted by time. Sweeps of other LiDARs at nearly the same time share the
/// number. The world frame is that of the poses.
Log load_nuscenes(const std::filesystem::path& folder, const DatasetOptions& options);

/// Frames are numbered in the order of the JSON file. The vehicle frame is the frame of
/// the LiDAR, rotated so that x points forward. The world frame is the LiDAR in the first
/// frame. Boxes are not loaded, because they have no track ids.
Log load_once(const std::filesystem::path& folder, const DatasetOptions& options);

/// Reads sequence.json, poses.txt, boxes.json and scans.
Log load_folder(const std::filesystem::path& folder, const DatasetOptions& options);

/// Generates the log of folder/street.toml. The origin of the world is the sensor in the
/// middle of the full log, even if only some frames are loaded.
Log load_synthetic(const std::filesystem::path& folder, const DatasetOptions& options);

/// A frame number is the index of the record. DatasetOptions::sequence selects a file by
/// the first characters of its name, with or without "segment-", or a part of a segment
/// with only TOP in the LiDAR-RT paper (ws1 to ws4, wd1 to wd4).
/// @param path  a .tfrecord file, or a folder of such files
Log load_waymo(const std::filesystem::path& path, const DatasetOptions& options);

}  // namespace relidar
