// SPDX-License-Identifier: Apache-2.0
// Benchmarks of the ray-drop network and of its most expensive layer.
#pragma once

#include <cstdint>
#include <memory>

#include <relidar/diff/network.hpp>
#include <relidar/gpu/device.hpp>

namespace relidar {

/// Size of a 3x3 convolution of one image.
struct ConvolutionSize {
    std::uint32_t rows = 0, columns = 0, n_in = 0, n_out = 0;

    /// Returns the number of multiplications and additions of one pass. The forward pass
    /// and both derivatives need the same number.
    double operations() const {
        return 2.0 * 9.0 * double(rows) * double(columns) * double(n_in) * double(n_out);
    }
};

/// A convolution on a device for benchmarks, with non-zero values. Each call blocks until
/// its pass is finished.
class MeasuredConvolution {
public:
    MeasuredConvolution(Device& device, const ConvolutionSize& size);
    ~MeasuredConvolution();

    void forward();
    void by_input();    ///< derivative with respect to the image
    void by_weights();  ///< derivative with respect to the weights

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Runs training and inference of a network on random images of one size, for benchmarks.
class MeasuredDropNetwork {
public:
    MeasuredDropNetwork(Device& device, const RefineOptions& options, int rows, int columns);
    ~MeasuredDropNetwork();

    void step();   ///< Runs one training step on options.batch images and blocks until it is finished.
    void infer();  ///< inference of one image; blocks
    /// Returns the number of multiplications and additions of one inference. A training
    /// step needs three times as many per image.
    double operations() const;
    /// Returns the milliseconds of each kernel of step(). Empty if the device has no
    /// timestamps.
    const KernelTimes& times() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
