// SPDX-License-Identifier: Apache-2.0
// Provides the rays and the measured drops of training frames. After training, they are
// compared with rendered frames, to estimate properties of the sensor. Private to train.
#pragma once

#include <vector>

#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/simulate/render.hpp>

#include "train/frames/frame_data.hpp"

namespace relidar {

/// Returns the nominal rays of a frame's LiDAR, or the rays of the scan if the scan has
/// other rows and columns.
SensorChoice make_nominal_rays_of_frame(const Config& config, const Sequence& sequence, const Frame& frame);

/// Selects the measurements that are ignored: those of moving objects without a model in
/// the scene.
Unknown make_masks(const Config& config, const Scene& scene);

/// Returns 0 for each returned ray of a frame and 1 for each dropped ray. Returns -1 for
/// a ray that hit, or may have hit, a moving object without a model in the scene.
std::vector<float> find_measured_drops(const Sequence& sequence, const Frame& frame, const Unknown& masks);

/// Returns at most `count` of the frame positions, evenly spaced. Returns all positions
/// if `count` is 0.
std::vector<int> select_evenly_spaced(const std::vector<int>& positions, int count);

}  // namespace relidar
