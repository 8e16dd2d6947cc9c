// SPDX-License-Identifier: Apache-2.0
#include "bench/training_step.hpp"

#include <algorithm>
#include <random>

#include <relidar/run/stage_options.hpp>

#include "bench/case.hpp"

namespace relidar::cli {

std::vector<DeviceTarget> noisy_targets(const RenderedRayValues& rendering, bool is_depth_divided_by_weight) {
    constexpr float kRangeNoise_m = 0.1f, kIntensityNoise = 0.05f, kMinReturnWeight = 0.5f;
    std::mt19937 random(1);
    // Uniform from -1 to 1: the random numbers have 32 bits.
    const auto noise = [&] { return static_cast<float>(random()) / 0x1p31f - 1.0f; };
    std::vector<DeviceTarget> targets(rendering.size(), {.range_m = 0.0f, .intensity = 0.0f, .weight = 1.0f});
    for (std::size_t i = 0; i < targets.size(); ++i) {
        if (!(rendering.weight[i] > kMinReturnWeight)) continue;
        const float range_m = rendering.depth[i] / (is_depth_divided_by_weight ? rendering.weight[i] : 1.0f);
        targets[i].range_m = std::max(range_m + kRangeNoise_m * noise(), 0.01f);
        targets[i].intensity = rendering.intensity[i] + kIntensityNoise * noise();
    }
    return targets;
}

/// Allocates renderer, gradients, losses and optimiser, and uploads the targets.
TrainingStep::TrainingStep(Device& device, const BenchCase& bench_case, const RendererOptions& options,
                           const std::vector<DeviceTarget>& target_values)
    : differentiable(device, bench_case.scene, bench_case.config.image, options,
                     // Does not set the gradients of surfels without hits to zero,
                     // because Adam skips these surfels.
                     {.sums = backward_options(bench_case.config), .zero_untouched = false}),
      renderer(differentiable.renderer()),
      targets(device, std::span<const DeviceTarget>(target_values), "targets"),
      loss_(device, bench_case.config.loss),
      adam_(device, renderer.scene().size(), {.only_touched = bench_case.config.train.only_touched},
            renderer.scene().surfel_parameters().parameters_used()),
      terms_(device, std::vector<float>(kLossTerms, 0.0f), "loss terms") {
    for (const DeviceTarget& target : target_values)
        if (target.range_m > 0.0f) ++n_returned_;
    if (bench_case.config.loss.likelihood > 0.0f) likelihood_loss_.emplace(device, bench_case.config.loss);
}

void TrainingStep::record_losses(const RayBatch& rays) {
    const std::uint32_t columns = std::max(rays.columns, 1u);
    const ImageShape image{rays.n_rays / columns, columns, false};
    const TargetBatch measured{&targets, 0, 1, rays.n_rays, n_returned_, static_cast<double>(rays.n_rays),
                               image};
    loss_.add_ray_losses(renderer.stream(), differentiable.last_batch(), measured, terms_);
    if (likelihood_loss_)
        likelihood_loss_->add_ray_losses(renderer.stream(), differentiable.last_batch(), measured, terms_);
}

void TrainingStep::record_optimizer() {
    constexpr LearningRates kFrozenRates{0.0, 0.0, 0.0, 0.0, 0.0, 0.05};
    const DeviceGradients& gradients = differentiable.gradients();
    adam_.record_step(renderer.stream(), renderer.scene().surfel_parameters(), gradients.surfels,
                      &gradients.touched, kFrozenRates, ++step_, renderer.model().sh_degree);
}

}  // namespace relidar::cli
