// SPDX-License-Identifier: Apache-2.0
#include "diff/network/measured_network.hpp"

#include <vector>

#include "diff/network/conv.hpp"

namespace relidar {
namespace {

constexpr std::uint32_t kTaps = 9;

std::vector<float> make_repeatable_test_values(std::size_t count) {
    std::vector<float> values(count);
    for (std::size_t i = 0; i < count; ++i) values[i] = float(i % 257) / 128.0f - 1.0f;
    return values;
}

Array<float, shared::ConvWeights> upload_test_values(Device& device, std::size_t n_values,
                                                     const char* description) {
    return {device, std::span<const float>(make_repeatable_test_values(n_values)), description};
}

refine::Tensor make_test_image_tensor(Device& device, const ConvolutionSize& size, std::uint32_t n_channels) {
    refine::Tensor result(device, n_channels, {1, size.rows, size.columns}, "images");
    result.values.upload(make_repeatable_test_values(result.values.size()));
    return result;
}

}  // namespace

struct ConvolutionBenchmark::Impl {
    refine::ConvolutionKernels conv;
    refine::Tensor from, to;
    Array<float, shared::ConvWeights> weights, d_weights;
    Stream stream;

    Impl(Device& device, const ConvolutionSize& size)
        : conv(device, kTaps),
          from(make_test_image_tensor(device, size, size.n_in)),
          to(make_test_image_tensor(device, size, size.n_out)),
          weights(upload_test_values(device, std::size_t(size.n_in) * size.n_out * kTaps, "weights")),
          d_weights(upload_test_values(device, weights.size(), "gradient of weights")),
          stream(device) {
        conv.reserve_partial_sums(device, conv.count_partial_sum_floats(from.grid, size.n_in, size.n_out));
    }
};

ConvolutionBenchmark::ConvolutionBenchmark(Device& device, const ConvolutionSize& size)
    : impl_(std::make_unique<Impl>(device, size)) {}
ConvolutionBenchmark::~ConvolutionBenchmark() = default;

void ConvolutionBenchmark::run_forward_pass() {
    impl_->conv.run_convolution(impl_->stream, impl_->from.get_all_channels(), impl_->weights.address(), {},
                                impl_->to.get_all_channels());
    impl_->stream.submit_and_wait();
}

void ConvolutionBenchmark::compute_input_gradient() {
    impl_->conv.backpropagate_input(impl_->stream, impl_->to.get_all_channels(), impl_->weights.address(),
                                    impl_->from.get_all_channels());
    impl_->stream.submit_and_wait();
}

void ConvolutionBenchmark::compute_weight_gradient() {
    impl_->conv.backpropagate_weights(impl_->stream, impl_->from.get_all_channels(),
                                      impl_->to.get_all_channels(), impl_->d_weights.address());
    impl_->stream.submit_and_wait();
}

}  // namespace relidar
