// SPDX-License-Identifier: Apache-2.0
// Sensors from Python: a name, a CSV table of beams, or a dict with the rays, named as in
// an npz file.
#pragma once

#include <pybind11/pybind11.h>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar::python {

/// Returns the sensor for a Python argument. None: the sensor of the run's settings.
/// @param lidar LiDAR of the log that the sensor is, or that it replaces
/// @throws UsageError or DataError as choose_sensor(); DataError for rays of wrong shape
/// or length
SensorChoice sensor_of(const pybind11::handle& sensor, const Run& run, int lidar);

/// Returns the rays as a dict: directions and origin [rows,columns,3] float32, time
/// [rows,columns] float32, ring [rows,columns] uint16.
pybind11::dict to_dict(const RayTable& rays);

}  // namespace relidar::python
