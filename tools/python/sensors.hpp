// SPDX-License-Identifier: Apache-2.0
// Sensors from Python: a name, a CSV beam table, or a dict with the rays themselves under
// the names of an npz.
#pragma once

#include <pybind11/pybind11.h>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar::python {

/// The sensor that is meant. None: the one that the run's settings name. @param lidar  of
/// the log, which it is or in whose place it stands
/// @throws UsageError, DataError as choose_sensor(); DataError for rays of wrong shape or
/// length
SensorChoice sensor_of(const pybind11::handle& sensor, const Run& run, int lidar);

/// Rays as a dict: directions, origin [rows,columns,3] float32; time [rows,columns]
/// float32; ring [rows,columns] uint16.
pybind11::dict to_dict(const RayTable& rays);

}  // namespace relidar::python
