// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/simulate/render.hpp>

#include "train/frames/frame_data.hpp"

namespace relidar {

/// If the scan has other rows and columns than the LiDAR, the rays of the scan.
SimulatedSensor nominal_sensor(const Config& config, const Log& sequence, const Frame& frame);

IgnoredMeasurements mask_movers(const Config& config, const Scene& scene);

/// [rays] 0 returned, 1 dropped, -1 if the ray hit, or may have hit, a moving object
/// without a model in the scene.
std::vector<float> classify_drops(const Log& log, const Frame& frame, const IgnoredMeasurements& rules);

/// All positions if `max_count` is 0.
std::vector<int> select_evenly(const std::vector<int>& frames, int max_count);

}  // namespace relidar
