// SPDX-License-Identifier: Apache-2.0
// Benchmarks of the ray-drop network and of its slowest layer, a convolution.
#pragma once

#include <cstdint>
#include <memory>

#include <relidar/diff/network.hpp>
#include <relidar/gpu/device.hpp>

namespace relidar {

/// Size of a 3x3 convolution of one image.
struct ConvolutionSize {
    std::uint32_t rows = 0, columns = 0, n_in = 0, n_out = 0;

    /// Returns the number of multiplications and additions of one pass. This number is
    /// the same for the forward pass and both derivatives.
    double count_convolution_flops() const {
        return 2.0 * 9.0 * double(rows) * double(columns) * double(n_in) * double(n_out);
    }
};

/// Convolution layer on a device, for benchmarks. Each function waits until its result is
/// finished.
class ConvolutionBenchmark {
public:
    ConvolutionBenchmark(Device& device, const ConvolutionSize& size);
    ~ConvolutionBenchmark();

    void run_forward_pass();
    void compute_input_gradient();   ///< computes the derivative with respect to the image
    void compute_weight_gradient();  ///< computes the derivative with respect to the weights

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Runs training and inference of a network on random images of one size, for benchmarks.
class RayDropNetworkBenchmark {
public:
    RayDropNetworkBenchmark(Device& device, const RayDropNetworkOptions& options, int rows, int columns);
    ~RayDropNetworkBenchmark();

    void
    run_training_step();   ///< Runs one training step on options.batch images and waits until it is finished.
    void run_inference();  ///< runs inference on one image and waits until it is finished
    /// Returns the number of multiplications and additions of inference on one image.
    /// Training needs three times as many operations per image.
    double count_inference_flops() const;
    /// Returns the duration of each kernel in run_training_step(), in milliseconds. Empty
    /// if the device has no timestamps.
    const KernelTimes& times() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
