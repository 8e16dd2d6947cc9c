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

/// A sensor to simulate, and where it is mounted. It replaces the sensor of the log or
/// follows a path of the user.
struct TargetSensor {
    /// Subfolder for the files of this sensor. If it is empty, the files are written into
    /// the output folder.
    std::string folder;
    SensorChoice sensor;
    Pose mounting;
    /// Model of the sensor. Empty for the sensor of the log, for a grid and for a sensor
    /// that does not spin.
    std::optional<SpinningSensor> spinning = {};
};

/// Sensors of a rig. Empty if a single sensor is simulated.
using Rig = std::optional<std::vector<MountedSensor>>;

/// @param sensor  name or file of the sensor; empty: the sensor of the log
std::vector<TargetSensor> list_target_sensors(const std::string& sensor, const Rig& rig, const Run& run,
                                              int lidar);

}  // namespace relidar::cli
