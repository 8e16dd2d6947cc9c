// SPDX-License-Identifier: Apache-2.0
// Compares batch normalisation (diff/network/channel_sums, norm_finish, norm and
// norm_vjp) with the double reference: values, derivatives, running mean and variance,
// and dropout. Also tests values far from zero.
#include "diff/network/layers.hpp"

#include "../../support/device.hpp"
#include "images.hpp"

namespace relidar {
namespace {

using network::ImageBatchSize, network::Norm, network::NormState, network::NormWeights;
using NormCase = test::ImageCase;
using test::OnDevice, test::compute_worst_error;

class NormTest : public test::DeviceTest {};
class NormSizes : public test::DeviceTest, public testing::WithParamInterface<NormCase> {};
INSTANTIATE_TEST_SUITE_P(Refine, NormSizes,
                         testing::Values(NormCase{{1, 66, 1030}, 3}, NormCase{{4, 5, 13}, 17},
                                         NormCase{{1, 7, 9}, 1}, NormCase{{4, 1, 3}, 9},
                                         NormCase{{1, 2, 1}, 3}, NormCase{{4, 33, 65}, 9}));

struct OnePass {
    Norm norm;
    NormState state;
    reference::NormLayer layer;
    Array<glm::vec2, shared::BetaGamma> beta_gamma;
    Array<glm::vec2, shared::RunningMoments> running;
    Stream stream;

    OnePass(Device& device, const NormCase& test_case)
        : norm(device),
          state(device, std::uint32_t(test_case.channels)),
          layer{test::make_random_floats(std::size_t(test_case.channels), 5, 0.5),
                test::make_random_floats(std::size_t(test_case.channels), 6),
                {},
                1e-5},
          beta_gamma(test::upload_pairs<shared::BetaGamma>(device, layer.beta, layer.gamma)),
          running(test::upload_pairs<shared::RunningMoments>(device,
                                                             std::vector<double>(layer.beta.size(), 0.5),
                                                             std::vector<double>(layer.beta.size(), 2.0))),
          stream(device) {
        norm.reserve_sums(std::uint32_t(test_case.channels), test_case.grid);
    }
    NormWeights weights() const { return {beta_gamma.address(), running.address()}; }
    test::ImageBatch forward(Device& device, const OnDevice& from, const NormCase& test_case) {
        const OnDevice to = OnDevice::make_unwritten(device, test_case.grid, test_case.channels);
        norm.normalise_batch(stream, from.slice(), weights(), state, to.slice());
        stream.submit_and_wait();
        return to.read();
    }
};

/// Computes the dropout factor of each value from the output for positive inputs.
std::vector<double> compute_gate(Device& device, const NormCase& test_case, float dropout,
                                 std::uint32_t key) {
    OnePass pass(device, test_case);
    const std::size_t n = std::size_t(test_case.channels);
    pass.beta_gamma =  // all outputs become 1
        test::upload_pairs<shared::BetaGamma>(device, std::vector<double>(n, 1.0),
                                              std::vector<double>(n, 0.0));
    pass.state.dropout = dropout;
    pass.state.dropout_key = key;
    return pass
        .forward(device, OnDevice(device, test::make_random_images(test_case.grid, test_case.channels, 1)),
                 test_case)
        .values;
}

double find_largest(const std::vector<double>& values) {
    double most = 1e-30;
    for (const double x : values) most = std::max(most, std::abs(x));
    return most;
}

/// Returns an upper bound for the terms whose sum is the derivative of an input. With two
/// pixels the terms nearly cancel.
double find_largest_term(const test::ImageBatch& from, const reference::NormLayer& layer,
                         const test::ImageBatch& upstream) {
    double scale = 0.0;
    const reference::Moments moments = reference::compute_moments(from);
    for (std::size_t k = 0; k < layer.gamma.size(); ++k)
        scale = std::max(scale, std::abs(layer.gamma[k]) / std::sqrt(moments.variance[k] + layer.epsilon));
    return scale * find_largest(upstream.values);
}

TEST_P(NormSizes, ForwardAndRunningMoments) {
    const NormCase& c = GetParam();
    const test::ImageBatch values = test::make_random_images(c.grid, c.channels, 1, 2.0, 0.7);
    OnePass pass(device(), c);
    const OnDevice from(device(), values);
    const test::ImageBatch actual = pass.forward(device(), from, c);
    const reference::Moments moments = reference::compute_moments(values);
    EXPECT_LT(compute_worst_error(actual, reference::normalise(values, moments, pass.layer)), test::kLayer);
    const double n = double(c.grid.n_pixels_total());
    const std::vector<glm::vec2> running = pass.running.download();
    for (std::size_t k = 0; k < running.size(); ++k) {
        EXPECT_NEAR(running[k].x, 0.9 * 0.5 + 0.1 * moments.mean[k], 1e-5);
        EXPECT_NEAR(running[k].y, 0.9 * 2.0 + 0.1 * moments.variance[k] * n / (n - 1.0), 1e-5);
    }
}

TEST_P(NormSizes, EvaluationUsesTheRunningMoments) {
    const NormCase& c = GetParam();
    const test::ImageBatch values = test::make_random_images(c.grid, c.channels, 1, 2.0, 0.7);
    OnePass pass(device(), c);
    pass.state.dropout = 0.9f;  // has no effect here
    pass.state.dropout_key = 3;
    const OnDevice from(device(), values), to = OnDevice::make_unwritten(device(), c.grid, c.channels);
    pass.norm.normalise(pass.stream, from.slice(), pass.weights(), pass.state, to.slice());
    pass.stream.submit_and_wait();
    const std::vector<double> mean(pass.layer.beta.size(), 0.5), variance(pass.layer.beta.size(), 2.0);
    EXPECT_LT(compute_worst_error(to.read(), reference::normalise(values, {mean, variance}, pass.layer)),
              test::kLayer);
    for (const glm::vec2& running : pass.running.download()) EXPECT_EQ(running, glm::vec2(0.5f, 2.0f));
}

TEST_P(NormSizes, Derivatives) {
    const NormCase& c = GetParam();
    for (const float dropout : {0.0f, 0.3f}) {
        const test::ImageBatch values = test::make_random_images(c.grid, c.channels, 1, 2.0, 0.7);
        test::ImageBatch upstream = test::make_random_images(c.grid, c.channels, 2);
        OnePass pass(device(), c);
        test::exclude_kinks(upstream, values, pass.layer.beta, pass.layer.gamma);
        pass.state.dropout = dropout;
        pass.state.dropout_key = 77;
        if (dropout > 0.0f) pass.layer.gate = compute_gate(device(), c, dropout, 77);
        const OnDevice from(device(), values), d_to(device(), upstream),
            d_from = OnDevice::make_unwritten(device(), c.grid, c.channels);
        const std::size_t n = 2 * std::size_t(c.channels);
        // writes only a part of the array, starting at the fourth element
        const Array<float> d_parameters = test::to_device(device(), std::vector<double>(n + 6, -7.0));
        const test::ImageBatch actual = pass.forward(device(), from, c);
        pass.norm.norm_vjp(pass.stream, from.slice(), pass.state, d_to.slice(), d_from.slice(),
                           {d_parameters, 4});
        pass.stream.submit_and_wait();
        EXPECT_LT(compute_worst_error(
                      actual, reference::normalise(values, reference::compute_moments(values), pass.layer)),
                  test::kLayer);
        const reference::NormGradient expected =
            reference::backpropagate_normalisation(values, pass.layer, upstream);
        const double scale =
            find_largest(expected.from.values) / find_largest_term(values, pass.layer, upstream);
        EXPECT_LT(compute_worst_error(d_from.read(), expected.from) * scale, 2e-5);
        const std::vector<double> d = test::to_doubles(d_parameters);
        std::vector<double> d_beta, d_gamma;
        for (std::size_t k = 0; k < n; k += 2) {
            d_beta.push_back(d[4 + k]);
            d_gamma.push_back(d[5 + k]);
        }
        EXPECT_LT(compute_worst_error(d_beta, expected.beta), test::kLayer);
        EXPECT_LT(compute_worst_error(d_gamma, expected.gamma), test::kLayer);
        for (const std::size_t k : {std::size_t(0), std::size_t(3), n + 4, n + 5})
            EXPECT_EQ(d[k], -7.0) << "wrote beside its parameters";
    }
}

TEST_P(NormSizes, DerivativeByABias) {
    const NormCase& c = GetParam();
    const test::ImageBatch upstream = test::make_random_images(c.grid, c.channels, 2, 1.0, 0.5);
    OnePass pass(device(), c);
    const OnDevice d_to(device(), upstream);
    const auto d_bias =
        test::to_device<shared::ConvBias>(device(), std::vector<double>(std::size_t(c.channels) + 1, -7.0));
    pass.norm.bias_vjp(pass.stream, d_to.slice(), d_bias.address());
    pass.stream.submit_and_wait();
    std::vector<double> actual = test::to_doubles(d_bias);
    EXPECT_EQ(actual.back(), -7.0) << "wrote past the end";
    actual.pop_back();
    EXPECT_LT(compute_worst_error(actual, reference::compute_channel_sums(upstream)), test::kLayer);
}

/// Tests values with mean 1000 and deviation 1. The formula E[x^2] - E[x]^2 would lose
/// all digits in single precision.
TEST_F(NormTest, MomentsOfValuesFarFromZero) {
    for (const ImageBatchSize& grid : {ImageBatchSize{1, 66, 1030}, ImageBatchSize{4, 7, 9}}) {
        const NormCase c{grid, 3};
        const test::ImageBatch values = test::make_random_images(grid, 3, 1, 1.0, 1000.0);
        OnePass pass(device(), c);
        pass.forward(device(), OnDevice(device(), values), c);
        const reference::Moments moments = reference::compute_moments(values);
        const std::vector<glm::vec2> actual = pass.state.moments.download();
        for (std::size_t k = 0; k < 3; ++k) {
            EXPECT_NEAR(actual[k].x, moments.mean[k], 1e-3);
            EXPECT_NEAR(actual[k].y, 1.0 / std::sqrt(moments.variance[k] + 1e-5), 1e-3);
        }
    }
}

/// With a single value the variance is 0.
TEST_F(NormTest, ASinglePixelIsFinite) {
    const NormCase c{{1, 1, 1}, 3};
    OnePass pass(device(), c);
    const test::ImageBatch actual =
        pass.forward(device(), OnDevice(device(), test::make_random_images(c.grid, 3, 1)), c);
    for (std::size_t k = 0; k < 3; ++k)
        EXPECT_NEAR(actual.values[k], std::max(pass.layer.beta[k], 0.0), 1e-5);
    for (const glm::vec2& running : pass.running.download())
        EXPECT_TRUE(std::isfinite(running.x) && std::isfinite(running.y));
}

TEST_F(NormTest, DropoutDropsItsShareByKey) {
    const NormCase c{{4, 33, 65}, 9};
    for (const float dropout : {0.1f, 0.5f}) {
        const std::vector<double> gate = compute_gate(device(), c, dropout, 11);
        double n_dropped = 0.0, of_image[4] = {}, same = 0.0;
        for (std::size_t i = 0; i < gate.size(); ++i) {
            EXPECT_TRUE(gate[i] == 0.0 || std::abs(gate[i] - 1.0 / (1.0 - double(dropout))) < 1e-6)
                << gate[i];
            n_dropped += gate[i] == 0.0;
            of_image[i / (gate.size() / 4)] += gate[i] == 0.0;
        }
        const double n = double(gate.size()),
                     deviation = std::sqrt(double(dropout) * (1.0 - double(dropout)) / n);
        EXPECT_NEAR(n_dropped / n, dropout, 5.0 * deviation);
        for (const double share : of_image) EXPECT_NEAR(share / (n / 4.0), dropout, 10.0 * deviation);
        EXPECT_EQ(gate, compute_gate(device(), c, dropout, 11));
        const std::vector<double> other = compute_gate(device(), c, dropout, 12);
        for (std::size_t i = 0; i < gate.size(); ++i) same += (gate[i] == 0.0) == (other[i] == 0.0);
        // Two independent masks agree if both drop or both keep a value.
        EXPECT_NEAR(same / n, double(dropout * dropout + (1.0f - dropout) * (1.0f - dropout)),
                    5.0 * 0.5 / std::sqrt(n));
    }
}

}  // namespace
}  // namespace relidar
