// SPDX-License-Identifier: Apache-2.0
#include "train/frames/measured_frame.hpp"

#include <cstddef>

namespace relidar {

SimulatedSensor choose_nominal_sensor_of_frame(const Config& config, const LidarSequence& sequence,
                                               const LidarFrame& frame) {
    SimulatedSensor sensor = find_or_load_sensor("native", config, sequence, frame.lidar);
    if (sensor.rays.rows != frame.scan.rays.rows || sensor.rays.columns != frame.scan.rays.columns) {
        sensor.rays = frame.scan.rays;
        sensor.follows_sweeps = false;
    }
    sensor.rolling_shutter = sequence.rolling_shutter;  // same setting as in the measured scan
    return sensor;
}

IgnoredMeasurements make_mask_for_movers_without_model(const Config& config, const Scene& scene) {
    IgnoredMeasurements masks{config.init, {}, {}};
    for (const ModelInstance& instance : scene.instances)
        if (!instance.track.empty()) masks.actors.push_back(instance.track);
    return masks;
}

std::vector<float> classify_measured_drops_per_ray(const LidarSequence& sequence, const LidarFrame& frame,
                                                   const IgnoredMeasurements& mask_rules) {
    std::vector<DeviceRay> rays;
    std::vector<DeviceTarget> targets;
    compute_training_rays_and_targets(sequence, frame, mask_rules, rays, targets);
    std::vector<float> dropped;
    for (std::size_t i = 0; i < targets.size(); ++i) {
        if (!(targets[i].weight > 0.0f)) dropped.push_back(-1.0f);
        else dropped.push_back(frame.scan.range_m[i] > 0.0f ? 0.0f : 1.0f);
    }
    return dropped;
}

std::vector<int> select_evenly_spaced_frames(const std::vector<int>& frame_indices, int max_count) {
    if (max_count <= 0 || frame_indices.size() <= std::size_t(max_count)) return frame_indices;
    std::vector<int> chosen;
    for (std::size_t i = 0; i < std::size_t(max_count); ++i)
        chosen.push_back(frame_indices[i * frame_indices.size() / std::size_t(max_count)]);
    return chosen;
}

}  // namespace relidar
