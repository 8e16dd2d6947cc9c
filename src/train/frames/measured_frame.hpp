// SPDX-License-Identifier: Apache-2.0
// Training frames rendered beside what was measured, for what is learnt of a sensor after
// training. Private to train.
#pragma once

#include <vector>

#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/simulate/render.hpp>

#include "train/frames/frame_data.hpp"

namespace relidar {

/// Rays of a frame's LiDAR: the nominal ones where they are in the order of its scan,
/// else those of the scan.
SensorChoice nominal_rays_of(const Config& config, const Sequence& sequence, const Frame& frame);

/// Where nothing is known of what was measured: moving things that are not in the scene.
Unknown masks_of(const Config& config, const Scene& scene);

/// What came back of a frame, 1 dropped, -1 where a moving thing that is not in the scene
/// was or may have been.
std::vector<float> measured_drops(const Sequence& sequence, const Frame& frame, const Unknown& masks);

/// At most n of the positions, spread over all; 0: all.
std::vector<int> spread(const std::vector<int>& positions, int n);

}  // namespace relidar
