// SPDX-License-Identifier: Apache-2.0
// Times the ray-drop network and its most expensive layer, for benchmarks.
#pragma once

#include <cstdint>
#include <memory>

#include <relidar/diff/network.hpp>
#include <relidar/gpu/device.hpp>

namespace relidar {

/// A convolution 3x3 of one image.
struct ConvolutionSize {
    std::uint32_t rows = 0, columns = 0, n_in = 0, n_out = 0;

    /// Products and sums of one pass, forward or either derivative.
    double operations() const {
        return 2.0 * 9.0 * double(rows) * double(columns) * double(n_in) * double(n_out);
    }
};

/// One on a device, of values that are not zero, run pass by pass. Each call blocks until
/// its pass is done.
class MeasuredConvolution {
public:
    MeasuredConvolution(Device& device, const ConvolutionSize& size);
    ~MeasuredConvolution();

    void forward();
    void by_input();    ///< derivative by the image
    void by_weights();  ///< derivative by the weights

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// A network's training and inference on noise of one image size.
class MeasuredDropNetwork {
public:
    MeasuredDropNetwork(Device& device, const RefineOptions& options, int rows, int columns);
    ~MeasuredDropNetwork();

    void step();   ///< of training, on options.batch images; done when it returns
    void infer();  ///< one image; done when it returns
    /// Products and sums of an inference; a step of training takes three times as many
    /// for each image.
    double operations() const;
    /// Milliseconds of the kernels of step(), by name, where the device has timestamps.
    const KernelTimes& times() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
