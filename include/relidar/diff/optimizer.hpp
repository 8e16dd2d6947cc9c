// SPDX-License-Identifier: Apache-2.0
// Adam over the parameter groups of all surfels, with one learning rate a group.
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
    /// surfels without a gradient in this batch keep values and moments; false: their
    /// moments decay, and move them
    bool only_touched = false;
    std::uint32_t n_fixed = 0;  ///< the first so many surfels stay as they are, and have no moments
};

/// Exponential interpolation from `start` at step 0 to `end` at step n_steps.
double exponential_schedule(double start, double end, int step, int n_steps);

class Adam {
public:
    Adam(Device& device, std::uint32_t n_surfels, const AdamOptions& options, ParameterSet of = {});
    ~Adam();
    /// Records one step. @param step counts from 1
    /// @param touched [n] 1 where a surfel has a gradient, that of the others counts as
    /// zero whatever it is; null: all have
    /// @param sh_degree active degree: higher coefficients are left alone
    void step(Stream& stream, SurfelArrays& parameters, const SurfelArrays& gradients,
              const Array<std::uint32_t, shared::TouchedSurfels>* touched, const LearningRates& rates,
              int step, int sh_degree);
    SurfelArrays& moment1();
    SurfelArrays& moment2();
    /// From now on no standard deviation is stepped beyond these. Their number must stay
    /// what it is.
    /// @param max_log_scale [n] log m, for every surfel
    void bound_scales(Device& device, const std::vector<float>& max_log_scale);
    Array<float>& max_log_scale();  ///< [n], or nothing where there are no bounds

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Adam over one array, all of it at one rate: the parameters of a network.
class ArrayAdam {
public:
    /// @param options  only_touched is for surfels
    ArrayAdam(Device& device, std::size_t n, const AdamOptions& options);
    ~ArrayAdam();
    /// Records one step. @param values [n] in place @param gradients [n] @param step
    /// counts from 1
    void step(Stream& stream, const Array<float>& values, const Array<float>& gradients, double rate,
              int step);
    Array<float>& moment1();
    Array<float>& moment2();

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
