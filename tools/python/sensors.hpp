// SPDX-License-Identifier: Apache-2.0
// Reads sensors from Python arguments. The argument is a name, a CSV file with a table of
// beams, or a dict with the arrays of an npz file.
#pragma once

#include <pybind11/pybind11.h>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar::python {

/// Returns the sensor that a Python argument describes. None means the sensor in the
/// settings of the run.
/// @param lidar LiDAR of the log that the sensor replaces
/// @throws UsageError or DataError if choose_sensor() rejects the sensor
/// @throws DataError if the ray arrays have a wrong shape, or a direction does not have
/// length 1
SimulatedSensor sensor_for_run(const pybind11::handle& sensor_name_or_ray_dict, const Run& run, int lidar);

/// Returns the rays of a sensor as a dict of arrays: directions and origin
/// [rows,columns,3] float32, time [rows,columns] float32, ring [rows,columns] uint16.
pybind11::dict to_array_dict(const RayTable& rays);

}  // namespace relidar::python
