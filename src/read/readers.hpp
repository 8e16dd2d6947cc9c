// SPDX-License-Identifier: Apache-2.0
// Loads a log of each dataset, for registry.cpp. All functions throw a DataError with the
// file and the field, line, record or message. They throw a UsageError if
// DatasetOptions::sequence is unknown or no scan is in the requested frame range.
#pragma once

#include <filesystem>

#include <relidar/read/dataset.hpp>

#include "read/scans/frame_range.hpp"

namespace relidar {

// The sources and the conventions of a log (Log::conventions) describe the frames. The
// path is the folder of the log unless stated otherwise.

Log load_argoverse2(const std::filesystem::path& folder, const DatasetOptions& options);
Log load_boreas(const std::filesystem::path& folder, const DatasetOptions& options);
/// @param drive  folder that contains velodyne_points
Log load_kitti_raw(const std::filesystem::path& drive, const DatasetOptions& options);
Log load_odometry(const std::filesystem::path& folder, const DatasetOptions& options);
/// DatasetOptions::sequence is the name of a sequence ("0003"), or its number ("3").
/// @param folder  folder that contains velodyne/, label_02/ and others, or a folder above
Log load_kitti_tracking(const std::filesystem::path& folder, const DatasetOptions& options);
/// Also loads View-of-Delft. Boxes are not loaded, because they have no track ids.
/// @param folder  folder that contains velodyne/, label_2/ and others, or a folder above
Log load_kitti_object(const std::filesystem::path& folder, const DatasetOptions& options);
/// DatasetOptions::sequence is the name of the drive's folder, the four digits in this
/// name, or a part of drive 0000 (lidar_rt_benchmark.hpp).
/// @param folder  folder that contains data_3d_raw
Log load_kitti_360(const std::filesystem::path& folder, const DatasetOptions& options);
Log load_mulran(const std::filesystem::path& folder, const DatasetOptions& options);
/// @param path  a store (*.zarr.itar or a folder *.zarr), or a folder of stores
Log load_ncore(const std::filesystem::path& path, const DatasetOptions& options);
/// DatasetOptions::sequence is the name of the scene ("scene-0061"), its first
/// characters, or its number ("61").
Log load_nuscenes(const std::filesystem::path& folder, const DatasetOptions& options);
/// Boxes are not loaded, because they have no track ids.
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
/// A frame number is the index of the record. DatasetOptions::sequence is the beginning
/// of a file name, with or without "segment-", or a part of a segment
/// (lidar_rt_benchmark.hpp), of which only the LiDAR TOP is read.
/// @param path  a .tfrecord file, or a folder of such files
Log load_waymo(const std::filesystem::path& path, const DatasetOptions& options);

}  // namespace relidar
