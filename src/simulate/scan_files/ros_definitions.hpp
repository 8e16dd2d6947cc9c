// SPDX-License-Identifier: Apache-2.0
// Definitions of the ROS 2 message types in recordings.
#pragma once

#include <string>

namespace relidar::scan_files {

/// Returns the fields of a message type, followed by the definitions of all types that it
/// contains. Readers need this text to decode messages.
/// @param type a type such as "nav_msgs/msg/Odometry" or "nav_msgs/Odometry" that this
/// file defines
std::string ros_definition(const std::string& type);

}  // namespace relidar::scan_files
