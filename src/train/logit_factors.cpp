// SPDX-License-Identifier: Apache-2.0
#include "train/logit_factors.hpp"

#include <algorithm>

namespace relidar {
namespace {

// Minimum sum of the rates of all steps that can move a logit, before the rates decay. In
// SH coefficients; the constant coefficient is 3.5 times its part of the logit.
constexpr double kMinReach = 50.0;
// Maximum rate, so that a single ray does not decide if a surfel returns.
constexpr double kMaxRate = 2.0;

/// Returns how often training is expected to fire each ray at each actor, [models].
std::vector<double> count_hitting_steps(const Scene& scene, std::span<const TrainingFrameData> frames,
                                        const TrainConfig& config) {
    std::vector<double> steps(scene.models.size(), 0.0);
    const double steps_per_frame = double(config.iterations) / double(frames.size());
    for (const TrainingFrameData& frame : frames) {
        const double rays = config.rays_per_iteration > 0 ? config.rays_per_iteration : frame.n_rays;
        for (std::size_t i = 0; i < frame.placed.size(); ++i)
            if (frame.placed[i].present)
                steps[scene.instances[i].model] +=
                    steps_per_frame * (rays < frame.n_rays ? rays / frame.n_rays : 1.0);
    }
    return steps;
}

}  // namespace

std::vector<float> logit_factors(const Scene& scene, std::span<const TrainingFrameData> frames,
                                 const TrainConfig& config) {
    const std::vector<double> steps = count_hitting_steps(scene, frames, config);
    std::vector<float> factors;
    for (std::size_t m = 0; m < steps.size(); ++m) {
        const bool is_actor = scene.models[m].half_size_m.x > 0.0f;
        const double rate = std::min(kMinReach / std::max(steps[m], 1.0), kMaxRate);
        factors.push_back(is_actor ? float(std::max(rate / config.sh_rate, 1.0)) : 1.0f);
    }
    if (std::ranges::all_of(factors, [](float factor) { return factor == 1.0f; })) factors.clear();
    return factors;
}

}  // namespace relidar
