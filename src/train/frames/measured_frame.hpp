// SPDX-License-Identifier: Apache-2.0
// Renders training frames for comparison with their measurements, to estimate properties
// of the sensor after training. Private to train.
#pragma once

#include <vector>

#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/simulate/render.hpp>

#include "train/frames/frame_data.hpp"

namespace relidar {

/// Returns the nominal rays of a frame's LiDAR if they have the same order as its scan,
/// otherwise the rays of the scan.
SensorChoice nominal_rays_of(const Config& config, const Sequence& sequence, const Frame& frame);

/// Returns which measurements are unknown: those of moving objects that are not in the
/// scene.
Unknown masks_of(const Config& config, const Scene& scene);

/// Returns the measured drops of a frame: 0 returned, 1 dropped. -1 means unknown,
/// because a moving object that is not in the scene was or may have been there.
std::vector<float> measured_drops(const Sequence& sequence, const Frame& frame, const Unknown& masks);

/// Returns at most n of the positions, evenly distributed. 0: all of them.
std::vector<int> spread(const std::vector<int>& positions, int n);

}  // namespace relidar
