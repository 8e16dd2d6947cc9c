// SPDX-License-Identifier: Apache-2.0
#include "train/frames/measured_frame.hpp"

#include <cstddef>

#include <relidar/run/run.hpp>
#include <relidar/train/train.hpp>

namespace relidar {

/// Returns the nominal rays of a frame's LiDAR. If the scan has other rows and columns,
/// returns the rays of the scan instead.
SimulatedSensor nominal_sensor(const Config& config, const Log& sequence, const Frame& frame) {
    SimulatedSensor sensor = choose_sensor("native", config, sequence, frame.lidar);
    if (sensor.rays.rows != frame.scan.rays.rows || sensor.rays.columns != frame.scan.rays.columns) {
        sensor.rays = frame.scan.rays;
        sensor.follows_sweeps = false;
    }
    sensor.rolling_shutter = sequence.rolling_shutter;  // same setting as in the measured scan
    return sensor;
}

IgnoredMeasurements mask_movers(const Config& config, const Scene& scene) {
    IgnoredMeasurements masks{config.init, {}, {}};
    for (const ModelInstance& instance : scene.instances)
        if (!instance.track.empty()) masks.actors.push_back(instance.track);
    return masks;
}

TrainingRays make_training_rays(const Run& run, const Frame& frame) {
    TrainingRays made;
    make_frame_arrays(run.sequence, frame, mask_movers(run.config, run.scene), made.rays, made.targets);
    return made;
}

/// Returns for each ray 1 if it was dropped, 0 if it returned, or -1 if it is unknown.
std::vector<float> classify_drops(const Log& log, const Frame& frame, const IgnoredMeasurements& rules) {
    std::vector<DeviceRay> rays;
    std::vector<DeviceTarget> targets;
    make_frame_arrays(log, frame, rules, rays, targets);
    std::vector<float> dropped;
    for (std::size_t i = 0; i < targets.size(); ++i) {
        if (!(targets[i].weight > 0.0f)) dropped.push_back(-1.0f);
        else dropped.push_back(frame.scan.range_m[i] > 0.0f ? 0.0f : 1.0f);
    }
    return dropped;
}

std::vector<int> select_evenly(const std::vector<int>& frames, int max_count) {
    if (max_count <= 0 || frames.size() <= std::size_t(max_count)) return frames;
    std::vector<int> chosen;
    for (std::size_t i = 0; i < std::size_t(max_count); ++i)
        chosen.push_back(frames[i * frames.size() / std::size_t(max_count)]);
    return chosen;
}

}  // namespace relidar
