// SPDX-License-Identifier: Apache-2.0
// Adam optimiser for the parameter groups of all surfels, with one learning rate per
// group.
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
    /// If true, surfels without a gradient in the batch keep their values and moments. If
    /// false, their moments decay and still change the values.
    bool only_touched = false;
    /// Number of surfels at the start of the arrays that are never changed and have no
    /// moments.
    std::uint32_t n_fixed = 0;
};

/// Interpolates exponentially from `start` at step 0 to `end` at step n_steps.
double exponential_schedule(double start, double end, int step, int n_steps);

class Adam {
public:
    Adam(Device& device, std::uint32_t n_surfels, const AdamOptions& options, ParameterSet of = {});
    ~Adam();
    /// Records an optimiser step.
    /// @param touched [n] 1 for each surfel with a gradient; gradients of other surfels
    /// are treated as zero. Null = all surfels have a gradient
    /// @param step number of the step, counted from 1
    /// @param sh_degree active SH degree; higher coefficients are not changed
    void step(Stream& stream, SurfelArrays& parameters, const SurfelArrays& gradients,
              const Array<std::uint32_t, shared::TouchedSurfels>* touched, const LearningRates& rates,
              int step, int sh_degree);
    SurfelArrays& moment1();
    SurfelArrays& moment2();
    /// Sets upper bounds of the standard deviations for all later steps. The number of
    /// surfels must then stay constant.
    /// @param max_log_scale [n] log m, for every surfel
    void bound_scales(Device& device, const std::vector<float>& max_log_scale);
    /// Upper bounds of the standard deviations, [n] log m; empty without bounds.
    Array<float>& max_log_scale();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Adam optimiser for one array with one learning rate, such as the parameters of a
/// network.
class ArrayAdam {
public:
    /// Allocates the moments.
    /// @param options only_touched is ignored, because it applies only to surfels
    ArrayAdam(Device& device, std::size_t n, const AdamOptions& options);
    ~ArrayAdam();
    /// Records an optimiser step.
    /// @param values [n] changed in place
    /// @param gradients [n] gradients of the values
    /// @param step number of the step, counted from 1
    void step(Stream& stream, const Array<float>& values, const Array<float>& gradients, double rate,
              int step);
    Array<float>& moment1();
    Array<float>& moment2();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
