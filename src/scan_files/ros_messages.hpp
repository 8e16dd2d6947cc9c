// SPDX-License-Identifier: Apache-2.0
// Scans as messages of ROS 2: CDR, with the definitions that a reader decodes them by.
#pragma once

#include <string>

#include "recorded_scan.hpp"

namespace relidar::scan_files {

/// sensor_msgs/msg/PointCloud2 and tf2_msgs/msg/TFMessage, with all that they are made of.
std::string ros_points_definition();
std::string ros_transform_definition();

/// Fields of the points of a cloud.
enum class RosPoints {
    plain,    ///< x y z intensity, float32
    autoware  ///< PointXYZIRCAEDT of Autoware and Nebula
};

/// The stamp is that of the first ray. Angles of RosPoints::autoware are those of x y z: azimuth from x to the left, elevation up, radians.
std::string ros_points(const RecordedScan& scan, RosPoints kind);
/// Of the sensor in the world, when the first ray was fired.
std::string ros_transform(const RecordedScan& scan);

/// Stamp of both, nanoseconds.
std::uint64_t ros_stamp_ns(const RecordedScan& scan);

}  // namespace relidar::scan_files
