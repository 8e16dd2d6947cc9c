// SPDX-License-Identifier: Apache-2.0
#include "diff/network/measured_network.hpp"

#include <vector>

#include "diff/network/conv.hpp"

namespace relidar {
namespace {

constexpr std::uint32_t kTaps = 9;

std::vector<float> numbers(std::size_t n) {
    std::vector<float> values(n);
    for (std::size_t i = 0; i < n; ++i) values[i] = float(i % 257) / 128.0f - 1.0f;
    return values;
}

Array<float, shared::ConvWeights> filled(Device& device, std::size_t n, const char* what) {
    return {device, std::span<const float>(numbers(n)), what};
}

refine::Tensor images(Device& device, const ConvolutionSize& size, std::uint32_t channels) {
    refine::Tensor result(device, channels, {1, size.rows, size.columns}, "images");
    result.values.upload(numbers(result.values.size()));
    return result;
}

}  // namespace

struct MeasuredConvolution::Impl {
    refine::Conv conv;
    refine::Tensor from, to;
    Array<float, shared::ConvWeights> weights, d_weights;
    Stream stream;

    Impl(Device& device, const ConvolutionSize& size)
        : conv(device, kTaps),
          from(images(device, size, size.n_in)),
          to(images(device, size, size.n_out)),
          weights(filled(device, std::size_t(size.n_in) * size.n_out * kTaps, "weights")),
          d_weights(filled(device, weights.size(), "gradient of weights")),
          stream(device) {
        conv.reserve(device, conv.partial_floats(from.grid, size.n_in, size.n_out));
    }
};

MeasuredConvolution::MeasuredConvolution(Device& device, const ConvolutionSize& size)
    : impl_(std::make_unique<Impl>(device, size)) {}
MeasuredConvolution::~MeasuredConvolution() = default;

void MeasuredConvolution::forward() {
    impl_->conv.forward(impl_->stream, impl_->from.all(), impl_->weights.address(), {}, impl_->to.all());
    impl_->stream.finish();
}

void MeasuredConvolution::by_input() {
    impl_->conv.input_vjp(impl_->stream, impl_->to.all(), impl_->weights.address(), impl_->from.all());
    impl_->stream.finish();
}

void MeasuredConvolution::by_weights() {
    impl_->conv.weights_vjp(impl_->stream, impl_->from.all(), impl_->to.all(), impl_->d_weights.address());
    impl_->stream.finish();
}

}  // namespace relidar
