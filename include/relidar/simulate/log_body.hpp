// SPDX-License-Identifier: Apache-2.0
// The body that carries the LiDAR of a log, as another sensor at its place sees it.
#pragma once

#include <relidar/log/own_vehicle.hpp>

namespace relidar {

struct Run;

/// Returns the directions in which something blocks the rays of a LiDAR of the log: the
/// body that carries it (Lidar::own_body), or a part that returns no light, so that all
/// rays drop (Scene::sensor_drop). Directions and ranges start at the log's LiDAR, so
/// they are right only for a sensor at about the same place.
/// @param lidar_from_sensor  pose of the other sensor in the frame of the log's LiDAR
/// @return a body without boxes; empty if nothing blocks the LiDAR
VehicleBody find_log_body(const Run& run, int lidar, const Pose& lidar_from_sensor);

}  // namespace relidar
