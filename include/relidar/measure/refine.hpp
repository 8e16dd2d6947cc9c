// SPDX-License-Identifier: Apache-2.0
// What the dearest layer of the ray-drop network costs, for benchmarks. Not installed.
#pragma once

#include <cstdint>
#include <memory>

#include <relidar/gpu.hpp>

namespace relidar {

/// A convolution 3x3 of one image.
struct ConvolutionSize {
    std::uint32_t rows = 0, columns = 0, n_in = 0, n_out = 0;

    /// Products and sums of one pass, forward or either derivative.
    double operations() const { return 2.0 * 9.0 * double(rows) * double(columns) * double(n_in) * double(n_out); }
};

/// One on a device, of values that are not zero, run pass by pass. Each call blocks until its pass is done.
class MeasuredConvolution {
public:
    MeasuredConvolution(Device& device, const ConvolutionSize& size);
    ~MeasuredConvolution();

    void forward();
    void by_input();     ///< derivative by the image
    void by_weights();   ///< derivative by the weights

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
