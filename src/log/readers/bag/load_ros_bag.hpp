// SPDX-License-Identifier: Apache-2.0
// Reader of ROS recordings: rosbag2 in MCAP or SQLite, ROS 1 bags, and MCAP files with
// ROS messages from other recorders.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads a recording.
/// @throws DataError with file, topic or message
Sequence load_ros_bag(const std::filesystem::path& path, const DatasetOptions& options);

}  // namespace relidar
