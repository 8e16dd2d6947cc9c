// SPDX-License-Identifier: Apache-2.0
// Checks the convolutions of the ray-drop network and their derivatives. Other layers are
// not checked, because the convolutions take most of the computing time.
#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "check/checks.hpp"
#include "diff/network/conv.hpp"
#include "gpu/kernel.hpp"

#include "../../../tests/reference/layers.hpp"

namespace relidar::cli {
namespace {

using reference::ImageBatch;

std::vector<double> make_random_floats(std::size_t count) {
    static std::mt19937 random(5);
    std::normal_distribution<float> normal;
    std::vector<double> values(count);
    for (double& x : values) x = normal(random);
    return values;
}

template <class Meaning = void>
Array<float, Meaning> to_device(Device& device, const std::vector<double>& values) {
    const std::vector<float> floats(values.begin(), values.end());
    return {device, std::span<const float>(floats), "values of a layer"};
}

refine::Tensor to_tensor(Device& device, const ImageBatch& images) {
    const refine::Grid grid{std::uint32_t(images.n), std::uint32_t(images.rows),
                            std::uint32_t(images.columns)};
    refine::Tensor tensor(device, std::uint32_t(images.channels), grid, "images of a layer");
    tensor.values.upload(std::vector<float>(images.values.begin(), images.values.end()));
    return tensor;
}

/// Returns the largest absolute error, divided by the largest absolute expected value.
double compute_worst_error(const std::vector<float>& actual, const std::vector<double>& expected) {
    double worst = 0.0, largest = 0.0;
    for (std::size_t i = 0; i < expected.size(); ++i) {
        const double error = std::abs(actual[i] - expected[i]);
        worst = std::isfinite(error) ? std::max(worst, error) : HUGE_VAL;
        largest = std::max(largest, std::abs(expected[i]));
    }
    return worst / largest;
}

double measure_convolution_error(Device& device, int taps) {
    const int n_in = 9, n_out = 17;
    ImageBatch from(2, n_in, 7, 33), d_to(2, n_out, 7, 33);
    from.values = make_random_floats(from.values.size());
    d_to.values = make_random_floats(d_to.values.size());
    const std::vector<double> weights = make_random_floats(std::size_t(n_in * n_out * taps)),
                              bias = make_random_floats(std::size_t(n_out));
    const refine::Tensor inputs = to_tensor(device, from), d_outputs = to_tensor(device, d_to),
                         outputs = to_tensor(device, d_to), d_inputs = to_tensor(device, from);
    const auto weights_there = to_device<shared::ConvWeights>(device, weights),
               d_weights = to_device<shared::ConvWeights>(device, weights);
    const auto bias_there = to_device<shared::ConvBias>(device, bias);
    refine::Conv conv(device, std::uint32_t(taps));
    conv.reserve(device, conv.count_partial_floats(inputs.grid, n_in, n_out));
    Stream stream(device);
    conv.forward(stream, inputs.all(), weights_there.address(), bias_there.address(), outputs.all());
    conv.backpropagate_input(stream, d_outputs.all(), weights_there.address(), d_inputs.all());
    conv.backpropagate_weights(stream, inputs.all(), d_outputs.all(), d_weights.address());
    stream.finish();
    return std::max(
        {compute_worst_error(outputs.values.download(),
                             reference::convolve(from, weights, bias, n_out, taps).values),
         compute_worst_error(d_inputs.values.download(),
                             reference::backpropagate_convolution_input(d_to, weights, n_in, taps).values),
         compute_worst_error(d_weights.download(),
                             reference::backpropagate_convolution_weights(from, d_to, taps))});
}

}  // namespace

Finding check_network(CheckedDevice& checked) {
    Device& device = checked.device();
    if (const std::string missing = list_missing_for_networks(device); !missing.empty())
        return make_unsupported_finding("missing " + missing);
    return judge(std::max(measure_convolution_error(device, 1), measure_convolution_error(device, 9)), 1e-5);
}

}  // namespace relidar::cli
