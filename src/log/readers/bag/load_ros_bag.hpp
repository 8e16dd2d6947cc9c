// SPDX-License-Identifier: Apache-2.0
// A recording of ROS as a log: rosbag2 (MCAP or SQLite), ROS 1, or MCAP of any recorder
// that writes ROS messages.
#pragma once

#include <filesystem>

#include <relidar/log/dataset.hpp>

namespace relidar {

/// @throws DataError naming file, topic or message
Sequence load_ros_bag(const std::filesystem::path& path, const DatasetOptions& options);

}  // namespace relidar
