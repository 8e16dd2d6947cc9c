// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>

#include "train/frames/frame_data.hpp"

namespace relidar {

/// Returns the learning rate of the hit and drop logits of each model, relative to the
/// rate of the background. Adam moves a logit by about its rate in a step, and only rays
/// that hit an actor move the logits of the actor. Without a higher rate, a dark actor
/// that few rays hit would still return everywhere at the end of training.
/// @param frames  training frames with the poses of their instances
/// @return [models] factors of at least 1; empty if all are 1
std::vector<float> logit_factors(const Scene& scene, std::span<const TrainingFrameData> frames,
                                 const TrainConfig& config);

}  // namespace relidar
