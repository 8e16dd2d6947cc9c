// SPDX-License-Identifier: Apache-2.0
// Reader of ROS recordings: rosbag2 (MCAP or SQLite), ROS 1, or MCAP of any recorder that
// writes ROS messages.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// Reads a recording.
/// @throws DataError with file, topic or message
Sequence load_ros_bag(const std::filesystem::path& path, const DatasetOptions& options);

}  // namespace relidar
