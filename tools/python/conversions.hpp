// SPDX-License-Identifier: Apache-2.0
// Converts between Python values and types of the library: settings, poses, surfels and
// sensors.
#pragma once

#include <relidar/log/log.hpp>
#include "arrays.hpp"

namespace relidar {
struct Config;
struct Run;
struct SimulatedSensor;
struct Surfels;
}  // namespace relidar

namespace relidar::python {

/// `relidar list settings` prints the names of settings. The values are Python values.
void set_value(Config& config, const std::string& key, const py::handle& value);
void show_warning(const std::string& message);
void set_values(Config& config, const py::dict& settings);

// A pose is a [4,4] float64 matrix. A track is a pair (times, poses).
Pose to_pose(const py::handle& matrix, const std::string& where);

/// @param time_s time of a single pose
/// @throws DataError if the object has another form, or a pose is not a rigid motion
PoseTrack to_track(const py::handle& object, const std::string& where, double time_s);

std::vector<Pose> to_poses(const py::handle& matrices, const std::string& where);

void append_pose(std::vector<double>& numbers, const Pose& pose);
py::array pose_matrix(const Pose& pose);

py::tuple to_times_and_poses(const PoseTrack& track, const glm::dvec3& position_offset_m);

/// Creates surfels from float32 arrays: mean [n,3], rotation [n,4], log_scale [n,2],
/// opacity_logit [n], sh [n,3,16]. 3D Gaussians also need log_scale_w [n].
/// @throws DataError if an array is missing or has a wrong shape
/// @throws UsageError if a name is unknown
Surfels read_surfels(const py::dict& arrays);

py::dict to_array_dict(Surfels&& surfels);

/// Returns the sensor that a Python argument describes. None means the sensor in the
/// settings of the run.
/// @param lidar LiDAR of the log that the sensor replaces
/// @throws UsageError or DataError if choose_sensor() rejects the sensor
/// @throws DataError if the ray arrays have a wrong shape, or a direction does not have
/// length 1
SimulatedSensor sensor_for_run(const py::handle& sensor_name_or_ray_dict, const Run& run, int lidar);

/// Returns the camera that a Python argument describes.
/// @param camera  a name or file of choose_camera(), or a dict with the keys of the file
/// @param lidar  LiDAR of the log that is the rig
Camera camera_for_run(const py::object& camera, const Run& run, int lidar);

/// Returns the rays of a sensor as a dict of arrays: directions and origin
/// [rows,columns,3] float32, time [rows,columns] float32, ring [rows,columns] uint16.
py::dict to_array_dict(const RayTable& rays);

}  // namespace relidar::python
