// SPDX-License-Identifier: Apache-2.0
#include "diff/network/measured_network.hpp"

#include <vector>

#include "diff/network/conv.hpp"

namespace relidar {
namespace {

constexpr std::uint32_t kTaps = 9;

std::vector<float> make_test_values(std::size_t count) {
    std::vector<float> values(count);
    for (std::size_t i = 0; i < count; ++i) values[i] = float(i % 257) / 128.0f - 1.0f;
    return values;
}

Array<float, shared::ConvWeights> make_filled_array(Device& device, std::size_t count,
                                                    const char* description) {
    return {device, std::span<const float>(make_test_values(count)), description};
}

refine::Tensor make_image_tensor(Device& device, const ConvolutionSize& size, std::uint32_t channels) {
    refine::Tensor result(device, channels, {1, size.rows, size.columns}, "images");
    result.values.upload(make_test_values(result.values.size()));
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
          from(make_image_tensor(device, size, size.n_in)),
          to(make_image_tensor(device, size, size.n_out)),
          weights(make_filled_array(device, std::size_t(size.n_in) * size.n_out * kTaps, "weights")),
          d_weights(make_filled_array(device, weights.size(), "gradient of weights")),
          stream(device) {
        conv.reserve(device, conv.count_partial_floats(from.grid, size.n_in, size.n_out));
    }
};

MeasuredConvolution::MeasuredConvolution(Device& device, const ConvolutionSize& size)
    : impl_(std::make_unique<Impl>(device, size)) {}
MeasuredConvolution::~MeasuredConvolution() = default;

void MeasuredConvolution::forward() {
    impl_->conv.forward(impl_->stream, impl_->from.all(), impl_->weights.address(), {}, impl_->to.all());
    impl_->stream.finish();
}

void MeasuredConvolution::run_input_gradient() {
    impl_->conv.backpropagate_input(impl_->stream, impl_->to.all(), impl_->weights.address(),
                                    impl_->from.all());
    impl_->stream.finish();
}

void MeasuredConvolution::run_weights_gradient() {
    impl_->conv.backpropagate_weights(impl_->stream, impl_->from.all(), impl_->to.all(),
                                      impl_->d_weights.address());
    impl_->stream.finish();
}

}  // namespace relidar
