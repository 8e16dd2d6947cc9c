// SPDX-License-Identifier: Apache-2.0
#include "render/target_sensors.hpp"

#include <fstream>
#include <sstream>

namespace relidar::cli {
namespace {

std::optional<SpinningSensor> as_spinning(const SensorModel& model) {
    const auto* spinning = std::get_if<SpinningSensor>(&model.pattern);
    return spinning ? std::optional(*spinning) : std::nullopt;
}

}  // namespace

std::optional<SpinningSensor> spinning_sensor_of(const std::string& name, const SimulatedSensor& simulated) {
    if (simulated.is_log_lidar || simulated.grid || simulated.pattern) return std::nullopt;
    return as_spinning(find_sensor(name));
}

/// Returns the sensors to simulate: all of a rig, or one. An empty name selects the
/// sensor of the settings.
std::vector<MountedSimulatedSensor> list_sensors(const std::string& name, const SensorRig& rig,
                                                 const Run& run, int lidar) {
    if (name.empty()) return {{"", make_sensor(run.config, run.sequence, lidar), {}}};
    if (!rig) {
        const SimulatedSensor choice = choose_sensor(name, run.config, run.sequence, lidar);
        return {{"", choice, {}, spinning_sensor_of(name, choice)}};
    }
    std::vector<MountedSimulatedSensor> targets;
    for (const MountedSensor& mounted : *rig)
        targets.push_back({mounted.name, simulate_sensor(mounted, lidar), mounted.rig_from_sensor,
                           as_spinning(mounted.sensor)});
    return targets;
}

std::string describe_inputs(const std::vector<std::string>& names_or_files) {
    std::ostringstream text;
    for (const std::string& name : names_or_files) {
        text << name << '\n';
        if (std::ifstream file(name); file.good() && file.peek() != EOF) text << file.rdbuf();
    }
    return text.str();
}

void remove_hidden_boxes(ScanOutputOptions& output, const Run& run, const std::vector<std::string>& visible) {
    if (visible.empty()) return;
    const std::vector<bool> shown = select_instances(run.scene, visible);
    // The first instance is the background, which contains all standing objects.
    if (!shown.front()) output.standing.clear();
    std::erase_if(output.actors, [&](const BoxTrack& box) {
        for (std::size_t i = 0; i < shown.size(); ++i)
            if (run.scene.instances[i].track == box.id) return !shown[i];
        // No instance has this track, so the actor is not rendered.
        return true;
    });
}

}  // namespace relidar::cli
