// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <vector>

#include <relidar/diff/differentiable_renderer.hpp>
#include <relidar/diff/loss.hpp>
#include <relidar/diff/optimizer.hpp>

namespace relidar::cli {

struct BenchCase;

/// Returns target values for the losses: a rendered image plus noise, so that the
/// gradient of an L1 loss is not zero. Rays with a low sum of blending weights become
/// rays without a return.
std::vector<DeviceTarget> noisy_targets(const RenderedRayValues& rendering, bool is_depth_divided_by_weight);

/// A training iteration that can be repeated: all learning rates are 0, so that the step
/// does not change the scene.
class TrainingStep {
public:
    TrainingStep(Device& device, const BenchCase& bench_case, const RendererOptions& options,
                 const std::vector<DeviceTarget>& target_values);

    DifferentiableRenderer differentiable;
    Renderer& renderer;  ///< The renderer of `differentiable`.
    Array<DeviceTarget> targets;

    void record_losses(const RayBatch& rays);
    void record_optimizer();

private:
    ImageLoss loss_;
    std::optional<LikelihoodLoss> likelihood_loss_;  ///< Loss that is used only if its weight is above 0.
    Adam adam_;
    Array<float> terms_;
    double n_returned_ = 0.0;
    int step_ = 0;
};

}  // namespace relidar::cli
