// SPDX-License-Identifier: Apache-2.0
// Selects the rays of training frames, and reports which rays were dropped.
#include "train/frames/measured_frame.hpp"

#include <cstddef>

namespace relidar {

SensorChoice make_nominal_rays_of_frame(const Config& config, const Sequence& sequence, const Frame& frame) {
    SensorChoice sensor = choose_sensor("native", config, sequence, frame.lidar);
    if (sensor.rays.rows != frame.scan.rays.rows || sensor.rays.columns != frame.scan.rays.columns)
        sensor.rays = frame.scan.rays, sensor.follows_sweeps = false;
    sensor.rolling_shutter = sequence.rolling_shutter;  // Uses the same setting as the measured scan.
    return sensor;
}

Unknown make_masks(const Config& config, const Scene& scene) {
    Unknown masks{config.init, {}, {}};
    for (const Instance& instance : scene.instances)
        if (!instance.track.empty()) masks.actors.push_back(instance.track);
    return masks;
}

std::vector<float> find_measured_drops(const Sequence& sequence, const Frame& frame, const Unknown& masks) {
    std::vector<DeviceRay> rays;
    std::vector<DeviceTarget> targets;
    make_targets(sequence, frame, masks, rays, targets);
    std::vector<float> dropped;
    for (std::size_t i = 0; i < targets.size(); ++i)
        dropped.push_back(!(targets[i].weight > 0.0f) ? -1.0f : frame.scan.range_m[i] > 0.0f ? 0.0f : 1.0f);
    return dropped;
}

std::vector<int> select_evenly_spaced(const std::vector<int>& positions, int count) {
    if (count <= 0 || positions.size() <= std::size_t(count)) return positions;
    std::vector<int> chosen;
    for (std::size_t i = 0; i < std::size_t(count); ++i)
        chosen.push_back(positions[i * positions.size() / std::size_t(count)]);
    return chosen;
}

}  // namespace relidar
