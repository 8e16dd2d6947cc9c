// SPDX-License-Identifier: Apache-2.0
// Rays and measured drops of training frames, which are compared with rendered frames to
// estimate properties of the sensor. Private to train.
#pragma once

#include <vector>

#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/simulate/render.hpp>

#include "train/frames/frame_data.hpp"

namespace relidar {

/// If the scan has other rows and columns than the LiDAR, the rays of the scan.
SimulatedSensor choose_nominal_sensor_of_frame(const Config& config, const LidarSequence& sequence,
                                               const LidarFrame& frame);

/// Of moving objects without a model in the scene.
IgnoredMeasurements make_mask_for_movers_without_model(const Config& config, const Scene& scene);

/// [rays] 0 returned, 1 dropped, -1 if the ray hit, or may have hit, a moving object
/// without a model in the scene.
std::vector<float> classify_measured_drops_per_ray(const LidarSequence& sequence, const LidarFrame& frame,
                                                   const IgnoredMeasurements& mask_rules);

/// All positions if `max_count` is 0.
std::vector<int> select_evenly_spaced_frames(const std::vector<int>& frame_indices, int max_count);

}  // namespace relidar
