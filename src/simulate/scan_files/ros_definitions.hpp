// SPDX-License-Identifier: Apache-2.0
// Provides the definitions of the ROS 2 message types that recordings use.
#pragma once

#include <string>

namespace relidar::scan_files {

/// Returns the definition of a message type, followed by the definitions of all types
/// that it contains. Readers need this text to decode messages.
/// @param message_type a type that the .cpp file defines, for example
/// "nav_msgs/msg/Odometry" or "nav_msgs/Odometry"
std::string make_ros_message_definition(const std::string& message_type);

}  // namespace relidar::scan_files
