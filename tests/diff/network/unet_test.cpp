// SPDX-License-Identifier: Apache-2.0
// Compares the complete network with the same network built from the layers of the double
// reference.
#include <algorithm>
#include <cmath>
#include <numeric>

#include "../../support/device.hpp"
#include "diff/network/drop_network.hpp"
#include "diff/network/unet.hpp"
#include "images.hpp"

namespace relidar {
namespace {

using network::BlockOffsets;
using network::ConvOffsets;
using network::UnetLayout;
using reference::ImageBatch;

/// Implements the network in double precision. In training mode, normalises each batch by
/// the mean and variance of that batch.
class ReferenceUnet {
public:
    ReferenceUnet(const RayDropNetwork& network, std::vector<double> parameters, bool training)
        : network_(network), plan_(network), parameters_(std::move(parameters)), training_(training) {}

    ImageBatch compute_logits(const ImageBatch& inputs) const {
        const std::size_t n_levels = network_.widths.size() - 1;
        std::vector<ImageBatch> skips{convolve(plan_.first_conv, inputs)};
        for (std::size_t l = 1; l <= n_levels; ++l)
            skips.push_back(
                run(plan_.down[l - 1][1], run(plan_.down[l - 1][0], reference::pool(skips.back()))));
        ImageBatch up;
        if (n_levels > 0) {
            up = std::move(skips.back());
            skips.pop_back();
            if (network_.heads > 0) attend(up);
        }
        for (std::size_t l = skips.size(); l-- > 0;)
            up = run(plan_.up[l][1], run(plan_.up[l][0], joined(up, skips[l])));
        return convolve(plan_.last_conv, up);
    }

private:
    const RayDropNetwork& network_;
    UnetLayout plan_;
    std::vector<double> parameters_;
    bool training_;

    std::vector<double> part(std::size_t first, std::size_t count) const {
        return {parameters_.begin() + std::ptrdiff_t(first),
                parameters_.begin() + std::ptrdiff_t(first + count)};
    }
    ImageBatch convolve(const ConvOffsets& layer, const ImageBatch& from) const {
        const std::vector<double> bias = layer.bias ? part(*layer.bias, layer.n_out) : std::vector<double>{};
        return reference::convolve(from,
                                   part(layer.weights, std::size_t(layer.n_in) * layer.n_out * layer.taps),
                                   bias, int(layer.n_out), int(layer.taps));
    }
    ImageBatch run(const BlockOffsets& block, const ImageBatch& from) const {
        reference::NormLayer layer;
        reference::Moments running;
        for (std::size_t c = 0; c < block.conv.n_in; ++c) {
            layer.beta.push_back(parameters_[block.beta_gamma + 2 * c]);
            layer.gamma.push_back(parameters_[block.beta_gamma + 2 * c + 1]);
            running.mean.push_back(double(network_.running[block.running + 2 * c]));
            running.variance.push_back(double(network_.running[block.running + 2 * c + 1]));
        }
        return convolve(block.conv, reference::normalise(
                                        from, training_ ? reference::compute_moments(from) : running, layer));
    }
    void attend(ImageBatch& images) const {
        const ImageBatch added =
            convolve(plan_.project, reference::attend(run(*plan_.query, images), int(network_.heads)));
        for (std::size_t i = 0; i < images.values.size(); ++i) images.values[i] += added.values[i];
    }
    static ImageBatch joined(const ImageBatch& below, const ImageBatch& skip) {
        if (below.channels == 0) return skip;
        const ImageBatch larger = reference::upsample(below, skip.rows, skip.columns);
        ImageBatch result(skip.n, below.channels + skip.channels, skip.rows, skip.columns, skip.circular);
        result.for_each([&](int image, int c, int y, int x) {
            result.at(image, c, y, x) =
                c < below.channels ? larger.at(image, c, y, x) : skip.at(image, c - below.channels, y, x);
        });
        return result;
    }
};

struct Shape {
    const char* name;
    std::vector<std::uint32_t> widths;
    std::uint32_t heads, taps;
    network::ImageBatchSize grid;
};

class UnetTest : public test::DeviceTest, public testing::WithParamInterface<Shape> {
protected:
    RayDropNetwork network_;
    ImageBatch inputs_;
    std::vector<double> parameters_;

    void prepare() {
        network_.inputs = {"log_range", "intensity", "drop_logit"};
        network_.widths = GetParam().widths;
        network_.heads = GetParam().heads;
        network_.taps = GetParam().taps;
        const UnetLayout plan(network_);
        network::init_parameters(network_, plan, 5);
        // uses random values instead of the initial zeros, which would hide errors of
        // gradients
        parameters_ = test::make_random_floats(plan.n_parameters, 6, 0.4, 0.1);
        network_.parameters.assign(parameters_.begin(), parameters_.end());
        const std::vector<double> running = test::make_random_floats(plan.n_running, 7, 0.3);
        for (std::size_t i = 0; i < running.size(); ++i)
            network_.running[i] = float(i % 2 ? 1.0 + std::abs(running[i]) : running[i]);
        inputs_ = test::make_random_images(GetParam().grid, 3, 8);
    }
    void fill_inputs(const network::Unet& unet) { test::upload(unet.input_images(), inputs_.values); }
};

INSTANTIATE_TEST_SUITE_P(Networks, UnetTest,
                         testing::Values(Shape{"two_levels", {4, 6, 8}, 0, 9, {2, 9, 13}},
                                         Shape{"attention", {4, 8}, 2, 9, {2, 7, 10}},
                                         Shape{"part_of_a_turn", {4, 6}, 0, 9, {2, 9, 13, false}},
                                         Shape{"pixel", {5}, 0, 1, {2, 3, 11}},
                                         Shape{"three_levels", {2, 4, 4, 6}, 3, 9, {1, 17, 26}}),
                         [](const auto& tested) { return std::string(tested.param.name); });

void expect_near(const std::vector<double>& device_result, const std::vector<double>& expected,
                 double tolerance, const char* description) {
    ASSERT_EQ(device_result.size(), expected.size());
    double error = 0.0, size = 0.0;
    for (std::size_t i = 0; i < device_result.size(); ++i) {
        error += (device_result[i] - expected[i]) * (device_result[i] - expected[i]);
        size += expected[i] * expected[i];
    }
    EXPECT_GT(size, 0.0) << description;
    EXPECT_LE(std::sqrt(error / size), tolerance) << description;
}

TEST_P(UnetTest, LogitsAreTheReferencesInBothModes) {
    prepare();
    network::Unet unet(device(), network_);
    unet.allocate(device(), GetParam().grid, true);
    fill_inputs(unet);
    Stream stream(device());
    unet.run_inference(stream);
    stream.submit_and_wait();
    expect_near(test::to_doubles(unet.logits().values),
                ReferenceUnet(network_, parameters_, false).compute_logits(inputs_).values, 1e-5,
                "evaluation");
    unet.forward(stream, 1, 0.0f);
    stream.submit_and_wait();
    expect_near(test::to_doubles(unet.logits().values),
                ReferenceUnet(network_, parameters_, true).compute_logits(inputs_).values, 1e-4, "training");
}

TEST_P(UnetTest, GradientAgreesWithDifferencesOfTheReference) {
    prepare();
    network::Unet unet(device(), network_);
    unet.allocate(device(), GetParam().grid, true);
    fill_inputs(unet);
    const std::vector<double> upstream = test::make_random_floats(GetParam().grid.n_pixels_total(), 9);
    test::upload(unet.d_logits(), upstream);
    Stream stream(device());
    unet.forward(stream, 1, 0.0f);
    unet.backward(stream);
    stream.submit_and_wait();
    const std::vector<double> gradients = test::to_doubles(unet.gradients());

    const auto loss = [&](std::size_t parameter, double step) {
        std::vector<double> moved = parameters_;
        moved[parameter] += step;
        const ImageBatch logits = ReferenceUnet(network_, std::move(moved), true).compute_logits(inputs_);
        return std::inner_product(upstream.begin(), upstream.end(), logits.values.begin(), 0.0);
    };
    const UnetLayout plan(network_);
    std::vector<std::pair<std::size_t, std::size_t>> groups;  // first index and number of parameters
    const auto add_conv = [&](const ConvOffsets& layer) {
        groups.emplace_back(layer.weights, std::size_t(layer.n_in) * layer.n_out * layer.taps);
        if (layer.bias) groups.emplace_back(*layer.bias, layer.n_out);
    };
    const auto add_block = [&](const BlockOffsets& block) {
        groups.emplace_back(block.beta_gamma, 2 * block.conv.n_in);
        add_conv(block.conv);
    };
    add_conv(plan.first_conv);
    for (const auto& blocks : plan.down) std::ranges::for_each(blocks, add_block);
    if (plan.query) {
        add_block(*plan.query);
        add_conv(plan.project);
    }
    for (const auto& blocks : plan.up) std::ranges::for_each(blocks, add_block);
    add_conv(plan.last_conv);
    for (const auto& [first, n] : groups) {
        std::vector<double> device_result, expected;
        for (std::size_t k = 0; k < std::min<std::size_t>(n, 6); ++k) {
            const std::size_t parameter = first + k * n / std::min<std::size_t>(n, 6);
            device_result.push_back(gradients[parameter]);
            expected.push_back((loss(parameter, 1e-6) - loss(parameter, -1e-6)) / 2e-6);
        }
        // A bias before a batch normalisation has an effect only through the zero padding
        // of the next convolution, so its gradient is small.
        const double largest =
            std::abs(*std::max_element(expected.begin(), expected.end(), [](double left, double right) {
                return std::abs(left) < std::abs(right);
            }));
        for (std::size_t k = 0; k < device_result.size(); ++k)
            EXPECT_NEAR(device_result[k], expected[k], 2e-3 * largest + 1e-3)
                << "parameter " << k << " of the group at " << first;
    }
}

}  // namespace
}  // namespace relidar
