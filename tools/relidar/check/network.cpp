// SPDX-License-Identifier: Apache-2.0
// Checks the convolutions of the ray-drop network and their derivatives. Other layers are
// not checked, because the convolutions take most of the computing time.
#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "check/checks.hpp"
#include "diff/network/layers.hpp"
#include "gpu/kernel.hpp"

#include "../../../tests/reference/layers.hpp"

namespace relidar::cli {
namespace {

using reference::ImageBatch;

std::vector<double> sample_normal(std::size_t n_samples) {
    static std::mt19937 random(5);
    std::normal_distribution<float> normal;
    std::vector<double> values(n_samples);
    for (double& x : values) x = normal(random);
    return values;
}

template <class Meaning = void>
Array<float, Meaning> upload_floats(Device& device, const std::vector<double>& values) {
    const std::vector<float> floats(values.begin(), values.end());
    return {device, std::span<const float>(floats), "values of a layer"};
}

network::Tensor upload_images(Device& device, const ImageBatch& images) {
    const network::ImageBatchSize grid{std::uint32_t(images.n), std::uint32_t(images.rows),
                                       std::uint32_t(images.columns)};
    network::Tensor tensor(device, std::uint32_t(images.channels), grid, "images of a layer");
    tensor.values.upload(std::vector<float>(images.values.begin(), images.values.end()));
    return tensor;
}

/// Returns the largest absolute error, divided by the largest absolute expected value.
/// NaN counts as an infinite error.
double relative_error(const std::vector<float>& actual, const std::vector<double>& expected) {
    double largest_error = 0.0, largest_value = 0.0;
    for (std::size_t i = 0; i < expected.size(); ++i) {
        const double error = std::abs(actual[i] - expected[i]);
        largest_error = std::isfinite(error) ? std::max(largest_error, error) : HUGE_VAL;
        largest_value = std::max(largest_value, std::abs(expected[i]));
    }
    return largest_error / largest_value;
}

/// Runs a convolution and its derivatives (vjp: vector-Jacobian product) on random
/// images, and compares them with the reference on the CPU. The odd numbers of channels,
/// rows and columns are not multiples of the tiles of the kernels.
/// @param n_kernel_taps pixels of the filter: 1, or 9 for 3 x 3
/// @return largest relative error of outputs, d_inputs and d_weights
double convolution_error(Device& device, int n_kernel_taps) {
    constexpr int kImages = 2, kRows = 7, kColumns = 33, kIn = 9, kOut = 17;
    ImageBatch inputs(kImages, kIn, kRows, kColumns), d_outputs(kImages, kOut, kRows, kColumns);
    inputs.values = sample_normal(inputs.values.size());
    d_outputs.values = sample_normal(d_outputs.values.size());
    const std::size_t n_weights = std::size_t(kIn) * std::size_t(kOut) * std::size_t(n_kernel_taps);
    const std::vector<double> weights = sample_normal(n_weights), bias = sample_normal(kOut);

    // Arrays on the device. Outputs are overwritten, so only their size matters.
    const network::Tensor device_inputs = upload_images(device, inputs),
                          device_outputs = upload_images(device, d_outputs),
                          device_d_outputs = upload_images(device, d_outputs),
                          device_d_inputs = upload_images(device, inputs);
    const auto device_weights = upload_floats<shared::ConvWeights>(device, weights),
               device_d_weights = upload_floats<shared::ConvWeights>(device, weights);
    const auto device_bias = upload_floats<shared::ConvBias>(device, bias);

    network::Convolution conv(device, std::uint32_t(n_kernel_taps));
    conv.reserve_weight_sums(device, device_inputs.grid, kIn, kOut);
    Stream stream(device);
    conv.run_convolution(stream, device_inputs, device_weights.address(), device_bias.address(),
                         device_outputs);
    conv.input_vjp(stream, device_d_outputs, device_weights.address(), device_d_inputs);
    conv.weights_vjp(stream, device_inputs, device_d_outputs, device_d_weights.address());
    stream.submit_and_wait();

    const ImageBatch outputs = reference::convolve(inputs, weights, bias, kOut, n_kernel_taps);
    const ImageBatch d_inputs = reference::conv_input_vjp(d_outputs, weights, kIn, n_kernel_taps);
    const std::vector<double> d_weights = reference::conv_weights_vjp(inputs, d_outputs, n_kernel_taps);
    return std::max({relative_error(device_outputs.values.download(), outputs.values),
                     relative_error(device_d_inputs.values.download(), d_inputs.values),
                     relative_error(device_d_weights.download(), d_weights)});
}

}  // namespace

CheckResult check_network(CheckedDevice& tested) {
    Device& device = tested.default_device();
    if (const std::string missing = missing_for_networks(device); !missing.empty())
        return unsupported_check("missing " + missing);
    return compare_error(std::max(convolution_error(device, 1), convolution_error(device, 9)), 1e-5);
}

}  // namespace relidar::cli
