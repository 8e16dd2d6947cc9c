// SPDX-License-Identifier: Apache-2.0
// One training step, to be timed.
#pragma once

#include <optional>
#include <vector>

#include <relidar/diff/differentiable_renderer.hpp>
#include <relidar/diff/loss.hpp>
#include <relidar/diff/optimizer.hpp>

namespace relidar::cli {

struct BenchCase;

/// Targets for the losses: a rendered image with uniform noise, so that no L1 term has
/// gradient
/// 0. A ray of low weight counts as dropped.
std::vector<DeviceTarget> noisy_targets(const Rendering& rendering, bool normalised_depth);

/// One training step. The learning rates are 0, so that the scene stays the same.
class TrainingStep {
public:
    TrainingStep(Device& device, const BenchCase& bench, const RendererOptions& options,
                 const std::vector<DeviceTarget>& wanted);

    DifferentiableRenderer renderer;
    Array<DeviceTarget> targets;

    void compare(const RayBatch& rays);  ///< records the losses, after record_forward()
    void optimise();                     ///< records Adam, after record_backward()

private:
    ImageLoss loss_;
    std::optional<LikelihoodLoss> likelihood_loss_;  ///< if its weight is above 0
    Adam adam_;
    Array<float> terms_;
    double n_returned_ = 0.0;
    int step_ = 0;
};

}  // namespace relidar::cli
