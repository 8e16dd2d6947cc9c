// SPDX-License-Identifier: Apache-2.0
// Adam optimiser for the parameters of all surfels. Each parameter group has a learning
// rate.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <relidar/gpu/stream.hpp>
#include <relidar/scene/device_scene.hpp>

namespace relidar {

struct AdamOptions {
    double beta1 = 0.9;
    double beta2 = 0.999;
    double epsilon = 1e-15;
    /// If true, a surfel that gets no gradient from the batch keeps its parameters and
    /// its Adam moments. If false, its moments decay and still change its parameters.
    bool only_touched = false;
    /// Number of fixed surfels at the start of the arrays. Fixed surfels never change and
    /// have no Adam moments.
    std::uint32_t n_fixed = 0;
};

/// Returns a value that changes exponentially from `start` at step 0 to `end` at step
/// n_steps.
double interpolate_exp(double start, double end, int step, int n_steps);

class Adam {
public:
    Adam(Device& device, std::uint32_t n_surfels, const AdamOptions& options, SurfelParameterSet used = {});
    ~Adam();
    /// Records GPU commands for one optimiser step.
    /// @param touched_flags [n] 1 for each surfel with a gradient. The gradients of other
    /// surfels are treated as zero. Null = all surfels have a gradient
    /// @param step_number number of the step, counted from 1
    /// @param sh_degree active degree of the spherical harmonics. Coefficients of higher
    /// degrees are not changed
    void record_step(Stream& stream, SurfelArrays& parameters, const SurfelArrays& gradients,
                     const Array<std::uint32_t, shared::TouchedSurfels>* touched_flags,
                     const LearningRates& learning_rates, int step_number, int sh_degree);
    SurfelArrays& first_moments();
    SurfelArrays& second_moments();
    /// Sets an upper bound on the standard deviations of each surfel for all later steps.
    /// After this call, the number of surfels must not change.
    /// @param max_log_scales [n] natural logarithm of the bound in metres
    void set_max_log_scales(Device& device, const std::vector<float>& max_log_scales);
    /// Sets a factor on the rate of the hit and drop logits of each model. record_step()
    /// then needs LearningRates::models.
    /// @param factors [models] empty: all factors are 1
    void set_logit_factors(std::vector<float> factors);
    /// Upper bounds on the standard deviations, [n], natural logarithm of metres. Empty
    /// without bounds.
    Array<float>& max_log_scales();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Adam optimiser for one array with one learning rate, for example the parameters of a
/// network.
class ArrayAdam {
public:
    /// Allocates the Adam moments.
    /// @param options only_touched is ignored, because it applies only to surfels
    ArrayAdam(Device& device, std::size_t n, const AdamOptions& options);
    ~ArrayAdam();
    /// Records GPU commands for one optimiser step.
    /// @param values [n] changed in place
    /// @param gradients [n] gradients of the values
    /// @param step_number number of the step, counted from 1
    void record_step(Stream& stream, const Array<float>& values, const Array<float>& gradients,
                     double learning_rate, int step_number);
    Array<float>& first_moments();
    Array<float>& second_moments();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
