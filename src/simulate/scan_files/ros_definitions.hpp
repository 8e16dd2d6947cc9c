// SPDX-License-Identifier: Apache-2.0
// Fields of the types of ROS 2 that recordings hold.
#pragma once

#include <string>

namespace relidar::scan_files {

/// Of a type, followed by those of all that it is made of, as a reader decodes messages
/// by them.
/// @param type  as "nav_msgs/msg/Odometry" or "nav_msgs/Odometry", one of those that are
/// known here
std::string ros_definition(const std::string& type);

}  // namespace relidar::scan_files
