// SPDX-License-Identifier: Apache-2.0
#include "render/target_sensors.hpp"

namespace relidar::cli {
namespace {

/// Returns the spinning sensor of a sensor model. Returns no value if the sensor does not
/// spin.
std::optional<SpinningSensor> get_spinning_sensor(const SensorModel& model) {
    const auto* spinning = std::get_if<SpinningSensor>(&model.pattern);
    return spinning ? std::optional(*spinning) : std::nullopt;
}

}  // namespace

std::optional<SpinningSensor> find_spinning_sensor(const std::string& name_or_file,
                                                   const SensorChoice& choice) {
    if (choice.is_own || choice.grid || choice.pattern) return std::nullopt;
    return get_spinning_sensor(find_sensor(name_or_file));
}

std::vector<TargetSensor> list_target_sensors(const std::string& sensor, const Rig& rig, const Run& run,
                                              int lidar) {
    if (sensor.empty()) return {{"", make_configured_sensor(run.config, run.sequence, lidar), {}}};
    if (!rig) {
        const SensorChoice choice = choose_sensor(sensor, run.config, run.sequence, lidar);
        return {{"", choice, {}, find_spinning_sensor(sensor, choice)}};
    }
    std::vector<TargetSensor> targets;
    for (const MountedSensor& mounted : *rig)
        targets.push_back({mounted.name, make_sensor_choice(mounted, lidar), mounted.rig_from_sensor,
                           get_spinning_sensor(mounted.sensor)});
    return targets;
}

}  // namespace relidar::cli
