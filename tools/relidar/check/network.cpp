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
    double worst = 0.0, largest = 0.0;
    for (std::size_t i = 0; i < expected.size(); ++i) {
        const double error = std::abs(actual[i] - expected[i]);
        worst = std::isfinite(error) ? std::max(worst, error) : HUGE_VAL;
        largest = std::max(largest, std::abs(expected[i]));
    }
    return worst / largest;
}

/// Runs a convolution and its derivatives by inputs and weights (vjp: vector-Jacobian
/// product) on random images. Compares them with the reference on the CPU.
double convolution_error(Device& device, int n_kernel_taps) {
    const int n_in = 9, n_out = 17;
    ImageBatch from(2, n_in, 7, 33), d_to(2, n_out, 7, 33);
    from.values = sample_normal(from.values.size());
    d_to.values = sample_normal(d_to.values.size());
    const std::vector<double> weights = sample_normal(std::size_t(n_in) * std::size_t(n_out) *
                                                      std::size_t(n_kernel_taps)),
                              bias = sample_normal(std::size_t(n_out));
    const network::Tensor inputs = upload_images(device, from), d_outputs = upload_images(device, d_to),
                          outputs = upload_images(device, d_to), d_inputs = upload_images(device, from);
    const auto weights_there = upload_floats<shared::ConvWeights>(device, weights),
               d_weights = upload_floats<shared::ConvWeights>(device, weights);
    const auto bias_there = upload_floats<shared::ConvBias>(device, bias);
    network::Convolution conv(device, std::uint32_t(n_kernel_taps));
    conv.reserve_weight_sums(device, conv.n_partial_sums(inputs.grid, n_in, n_out));
    Stream stream(device);
    conv.run_convolution(stream, inputs, weights_there.address(), bias_there.address(), outputs);
    conv.input_vjp(stream, d_outputs, weights_there.address(), d_inputs);
    conv.weights_vjp(stream, inputs, d_outputs, d_weights.address());
    stream.submit_and_wait();
    return std::max(
        {relative_error(outputs.values.download(),
                        reference::convolve(from, weights, bias, n_out, n_kernel_taps).values),
         relative_error(d_inputs.values.download(),
                        reference::conv_input_vjp(d_to, weights, n_in, n_kernel_taps).values),
         relative_error(d_weights.download(), reference::conv_weights_vjp(from, d_to, n_kernel_taps))});
}

}  // namespace

CheckResult check_network(CheckedDevice& tested) {
    Device& device = tested.default_device();
    if (const std::string missing = missing_for_networks(device); !missing.empty())
        return unsupported_check("missing " + missing);
    return compare_error(std::max(convolution_error(device, 1), convolution_error(device, 9)), 1e-5);
}

}  // namespace relidar::cli
