// SPDX-License-Identifier: Apache-2.0
// Lists the sensors that `relidar render` simulates.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/sensor_files.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar::cli {

/// A sensor to simulate and its mounting pose. The sensor replaces the log's sensor, or
/// it follows a path of the user.
struct MountedSimulatedSensor {
    /// Subfolder for the files of this sensor. If the name is empty, the files are
    /// written into the output folder itself.
    std::string folder;
    SimulatedSensor sensor;
    Pose mounting;
    /// Model of the sensor if it is a spinning sensor, else no value. The log's sensor
    /// and a regular grid of rays have no model.
    std::optional<SpinningSensor> spinning = {};
};

/// Sensors of a rig. Empty if a single sensor is simulated.
using SensorRig = std::optional<std::vector<MountedSensor>>;

/// Returns the spinning sensor with this name, or from this file. Returns no value for
/// the log's sensor, for a regular grid of rays, and for a sensor that does not spin.
std::optional<SpinningSensor> find_spinning_sensor(const std::string& name_or_file,
                                                   const SimulatedSensor& simulated_sensor);

/// Returns the sensors that the command simulates.
/// @param sensor_name_or_file  name or file of the sensor; empty means the sensor of the
/// log
std::vector<MountedSimulatedSensor> list_sensors_of_rig_or_single_sensor(
    const std::string& sensor_name_or_file, const SensorRig& rig, const TrainedRun& run, int lidar_index);

}  // namespace relidar::cli
