// SPDX-License-Identifier: Apache-2.0
// Loads ROS recordings: rosbag2 in MCAP or SQLite, ROS 1 bags, and MCAP files with ROS
// messages from other recorders.
#pragma once

#include <filesystem>

#include <relidar/read/dataset.hpp>

namespace relidar {

/// Loads a recording as a log.
/// @throws DataError with the file, topic or message that caused the error
Log load_ros_bag(const std::filesystem::path& path, const DatasetOptions& options);

}  // namespace relidar
