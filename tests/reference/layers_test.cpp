// SPDX-License-Identifier: Apache-2.0
// Tests the layers in double against values computed by hand, and each derivative against
// central differences of the layer.
#include <cmath>
#include <functional>
#include <random>

#include <gtest/gtest.h>

#include "../support/tolerances.hpp"
#include "layers.hpp"

namespace relidar::reference {
namespace {

std::vector<double> make_random_values(std::size_t count, std::uint64_t seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal;
    std::vector<double> values(count);
    for (double& x : values) x = normal(random);
    return values;
}

ImageBatch make_random_images(int count, int channels, int rows, int columns, std::uint64_t seed) {
    ImageBatch images(count, channels, rows, columns);
    images.values = make_random_values(images.values.size(), seed);
    return images;
}

double dot(const std::vector<double>& a, const std::vector<double>& b) {
    double sum = 0.0;
    for (std::size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
    return sum;
}

/// Compares `actual` with central differences of the inner product <requested, value()>
/// with respect to each element of `values`. The function value() reads `values`.
void expect_derivative(std::vector<double>& values, const std::vector<double>& actual,
                       const std::vector<double>& requested,
                       const std::function<std::vector<double>()>& value) {
    ASSERT_EQ(values.size(), actual.size());
    double largest = 0.0;
    for (std::size_t i = 0; i < values.size(); ++i) {
        const double start = values[i], h = test::kDifferenceStep;
        values[i] = start + h;
        const double above = dot(requested, value());
        values[i] = start - h;
        const double below = dot(requested, value());
        values[i] = start;
        EXPECT_NEAR(actual[i], (above - below) / (2.0 * h), 1e-7 * (1.0 + std::abs(actual[i]))) << i;
        largest = std::max(largest, std::abs(actual[i]));
    }
    EXPECT_GT(largest, 0.01);
}

TEST(LayersReference, ConvolutionTurnsAroundAndEndsInZeros) {
    ImageBatch from(1, 1, 3, 4);
    from.at(0, 0, 0, 0) = 1.0;
    const std::vector<double> weights{1, 2, 3, 4, 5, 6, 7, 8, 9};
    const ImageBatch to = convolve(from, weights, {0.5}, 1, 9);
    // The kernel weight to the left passes an impulse to the next column. The weight to
    // the right passes it to the previous column, which is the last column of the ring.
    // Rows outside the image are zero.
    const std::vector<double> expected{5.5, 4.5, 0.5, 6.5, 2.5, 1.5, 0.5, 3.5, 0.5, 0.5, 0.5, 0.5};
    EXPECT_EQ(to.values, expected);
    // Less than a full turn: nothing passes from the first to the last column.
    from.circular = false;
    const std::vector<double> ended{5.5, 4.5, 0.5, 0.5, 2.5, 1.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5};
    EXPECT_EQ(convolve(from, weights, {0.5}, 1, 9).values, ended);
}

/// The weights are [output channels, input channels, taps].
TEST(LayersReference, ConvolutionMixesChannels) {
    ImageBatch from(1, 2, 1, 2);
    from.values = {1.0, 2.0, 10.0, 20.0};
    const std::vector<double> expected{51.0, 102.0, 30.5, 60.5, 15.0, 30.0};
    EXPECT_EQ(convolve(from, {1, 5, 0, 3, 5, 1}, {0.0, 0.5, 0.0}, 3, 1).values, expected);
}

TEST(LayersReference, NormalisationByHand) {
    ImageBatch from(2, 1, 1, 2);
    from.values = {1.0, 3.0, 5.0, 7.0};
    const Moments moments = compute_moments(from);
    EXPECT_EQ(moments.mean, std::vector{4.0});
    EXPECT_EQ(moments.variance, std::vector{5.0});
    // gamma (x - mean) / sqrt(variance + epsilon) + beta, and 0 for negative values
    const std::vector<double> expected{0.0, 0.0, 1.5, 3.5};
    EXPECT_EQ(normalise(from, moments, {{0.5}, {3.0}, {}, 4.0}).values, expected);
}

/// Odd rows and columns are ignored. The first of several largest pixels gets the
/// gradient.
TEST(LayersReference, PoolByHand) {
    ImageBatch from(1, 1, 3, 5), d_to(1, 1, 1, 2);
    from.values = {0, 2, 1, 1, 9, 2, 1, 1, 3, 9, 9, 9, 9, 9, 9};
    d_to.values = {4, 5};
    const std::vector<double> pooled{2, 3}, d_from{0, 4, 0, 0, 0, 0, 0, 0, 5, 0, 0, 0, 0, 0, 0};
    EXPECT_EQ(pool(from).values, pooled);
    EXPECT_EQ(backpropagate_pool(from, d_to).values, d_from);
}

TEST(LayersReference, UpsamplingByHand) {
    ImageBatch from(1, 1, 1, 2);
    from.values = {0.0, 4.0};
    // The source positions are -1/4, 1/4, 3/4 and 5/4. Each value mixes the two nearest
    // columns with weights 3/4 and 1/4. Columns wrap around.
    const ImageBatch to = upsample(from, 2, 4);
    const std::vector<double> expected{1.0, 1.0, 3.0, 3.0, 1.0, 1.0, 3.0, 3.0};
    for (std::size_t i = 0; i < 8; ++i) EXPECT_DOUBLE_EQ(to.values[i], expected[i]) << i;
    from.circular = false;
    const std::vector<double> clamped{0.0, 1.0, 3.0, 4.0, 0.0, 1.0, 3.0, 4.0};
    EXPECT_EQ(upsample(from, 2, 4).values, clamped);
}

TEST(LayersReference, EvenAttentionIsTheMean) {
    ImageBatch qkv(1, 3, 1, 4);
    qkv.values = {0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 10};  // queries are zero, so all scores are zero
    for (const double x : attend(qkv, 1).values) EXPECT_DOUBLE_EQ(x, 7.0);
}

TEST(LayersReference, ConvolutionDerivatives) {
    for (const auto& [taps, circular] : {std::pair(1, true), {9, true}, {9, false}}) {
        ImageBatch from = make_random_images(2, 3, 2, 5, 1);
        std::vector<double> weights = make_random_values(std::size_t(2 * 3 * taps), 2);
        ImageBatch d_output = make_random_images(2, 2, 2, 5, 3);
        from.circular = d_output.circular = circular;
        const auto value = [&, n_taps = taps] { return convolve(from, weights, {}, 2, n_taps).values; };
        expect_derivative(from.values, conv_input_vjp(d_output, weights, 3, taps).values, d_output.values,
                          value);
        expect_derivative(weights, conv_weights_vjp(from, d_output, taps), d_output.values, value);
    }
}

TEST(LayersReference, NormalisationDerivatives) {
    ImageBatch from = make_random_images(2, 3, 2, 5, 4);
    NormLayer layer{make_random_values(3, 5), make_random_values(3, 6),
                    std::vector<double>(from.values.size(), 1.5), 1e-2};
    for (std::size_t i = 0; i < layer.gate.size(); i += 3) layer.gate[i] = 0.0;
    const ImageBatch d_output = make_random_images(2, 3, 2, 5, 7);
    const auto value = [&] { return normalise(from, compute_moments(from), layer).values; };
    const NormGradient d = backpropagate_normalisation(from, layer, d_output);
    expect_derivative(from.values, d.from.values, d_output.values, value);
    expect_derivative(layer.beta, d.beta, d_output.values, value);
    expect_derivative(layer.gamma, d.gamma, d_output.values, value);
}

TEST(LayersReference, ResamplingDerivatives) {
    ImageBatch from = make_random_images(2, 2, 3, 5, 8);
    const ImageBatch small = make_random_images(2, 2, 1, 2, 9);
    ImageBatch large = make_random_images(2, 2, 7, 11, 10);
    expect_derivative(from.values, backpropagate_pool(from, small).values, small.values,
                      [&] { return pool(from).values; });
    for (const bool circular : {true, false}) {
        from.circular = large.circular = circular;
        expect_derivative(from.values, upsample_vjp(large, 3, 5).values, large.values,
                          [&] { return upsample(from, 7, 11).values; });
    }
}

TEST(LayersReference, AttentionDerivative) {
    ImageBatch qkv = make_random_images(2, 12, 2, 3, 11);
    const ImageBatch d_output = make_random_images(2, 4, 2, 3, 12);
    expect_derivative(qkv.values, attention_vjp(qkv, 2, d_output).values, d_output.values,
                      [&] { return attend(qkv, 2).values; });
}

TEST(LayersReference, EntropyDerivative) {
    std::vector<double> logit{-3.0, -0.5, 0.2, 4.0, 900.0, -900.0};
    const std::vector<double> target{1.0, 0.0, -1.0, 1.0, 0.0, 0.0}, one{1.0};
    const DropEntropy entropy = compute_drop_entropy(logit, target);
    EXPECT_NEAR(
        entropy.mean,
        (std::log1p(std::exp(3.0)) + std::log1p(std::exp(-0.5)) + std::log1p(std::exp(-4.0)) + 900.0) / 5.0,
        1e-12);
    EXPECT_NEAR(entropy.accuracy, 3.0 / 5.0, 1e-12);
    expect_derivative(logit, entropy.d_logit, one,
                      [&] { return std::vector<double>{compute_drop_entropy(logit, target).mean}; });
}

}  // namespace
}  // namespace relidar::reference
