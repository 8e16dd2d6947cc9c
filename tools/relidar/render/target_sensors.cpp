// SPDX-License-Identifier: Apache-2.0
#include "render/target_sensors.hpp"

namespace relidar::cli {
namespace {

std::optional<SpinningSensor> get_if_spinning_sensor(const SensorModel& model) {
    const auto* spinning = std::get_if<SpinningSensor>(&model.pattern);
    return spinning ? std::optional(*spinning) : std::nullopt;
}

}  // namespace

std::optional<SpinningSensor> find_spinning_sensor(const std::string& name_or_file,
                                                   const SimulatedSensor& simulated_sensor) {
    if (simulated_sensor.is_log_lidar || simulated_sensor.grid || simulated_sensor.pattern)
        return std::nullopt;
    return get_if_spinning_sensor(find_sensor(name_or_file));
}

std::vector<MountedSimulatedSensor> list_sensors_of_rig_or_single_sensor(
    const std::string& sensor_name_or_file, const SensorRig& rig, const TrainedRun& run, int lidar_index) {
    if (sensor_name_or_file.empty())
        return {{"", make_sensor_from_config(run.config, run.sequence, lidar_index), {}}};
    if (!rig) {
        const SimulatedSensor choice =
            find_or_load_sensor(sensor_name_or_file, run.config, run.sequence, lidar_index);
        return {{"", choice, {}, find_spinning_sensor(sensor_name_or_file, choice)}};
    }
    std::vector<MountedSimulatedSensor> targets;
    for (const MountedSensor& mounted : *rig)
        targets.push_back({mounted.name, make_simulated_sensor(mounted, lidar_index), mounted.rig_from_sensor,
                           get_if_spinning_sensor(mounted.sensor)});
    return targets;
}

}  // namespace relidar::cli
