// SPDX-License-Identifier: Apache-2.0
// refine/conv_matrix and refine/conv_weights_matrix against the double reference. Operands are numbers that a half holds, so that sums of
// floats are all that differs; others, scaled gradients and what no half holds have tests of their own. Skipped where a device has no
// matrix units, where instead the line that says so is tested.
#include <cmath>

#include <gmock/gmock.h>

#include <relidar/error.hpp>

#include "../support/device.hpp"
#include "gpu/stream.hpp"
#include "conv_case.hpp"
#include "images.hpp"
#include "refine/conv.hpp"

namespace relidar {
namespace {

using refine::Conv, refine::Grid, refine::Precision;
using test::OnDevice, test::worst_error;

using Case = test::ConvCase;

/// Tests of what needs matrix units.
class MatrixTest : public test::DeviceTest {
protected:
    void SetUp() override {
        test::DeviceTest::SetUp();
        if (IsSkipped() || HasFailure()) return;
        const std::string& missing = device().info().why_not_matrices;
        if (!missing.empty()) GTEST_SKIP() << "no matrix units: missing " << missing;
    }
};
class MatrixSizes : public MatrixTest, public testing::WithParamInterface<Case> {};
INSTANTIATE_TEST_SUITE_P(Refine, MatrixSizes,
                         testing::Values(Case{9, {1, 66, 1030}, 9, 3}, Case{1, {1, 66, 1030}, 3, 17}, Case{9, {3, 5, 13}, 17, 40},
                                         Case{9, {1, 5, 13}, 40, 17}, Case{1, {3, 5, 13}, 40, 3}, Case{9, {1, 4, 300}, 40, 70},
                                         Case{1, {2, 3, 129}, 70, 40}, Case{9, {3, 1, 3}, 3, 3}, Case{9, {1, 2, 1}, 1, 8},
                                         Case{9, {1, 3, 2}, 8, 16}, Case{9, {1, 20, 64}, 32, 32}, Case{9, {1, 1, 1}, 1, 1}));

/// Normal deviates in steps of 1/64: halves.
std::vector<double> halves(std::size_t n, std::uint64_t seed) {
    std::vector<double> values = test::random_floats(n, seed);
    for (double& x : values) x = std::round(64.0 * x) / 64.0;
    return values;
}

test::ImageBatch half_images(const Grid& grid, int channels, std::uint64_t seed) {
    test::ImageBatch images(int(grid.n), channels, int(grid.rows), int(grid.columns));
    images.values = halves(images.values.size(), seed);
    return images;
}

struct HalfLayer {
    test::ImageBatch from, d_to;
    std::vector<double> weights, bias;

    explicit HalfLayer(const Case& c)
        : from(half_images(c.grid, c.n_in, 1)),
          d_to(half_images(c.grid, c.n_out, 2)),
          weights(halves(std::size_t(c.n_in) * c.n_out * c.taps, 3)),
          bias(test::random_floats(std::size_t(c.n_out), 4)) {}
};

TEST_P(MatrixSizes, Forward) {
    const Case& c = GetParam();
    const HalfLayer layer(c);
    Conv conv(device(), c.taps, Precision::fp16);
    Stream stream(device());
    const OnDevice from(device(), layer.from), to = OnDevice::unwritten(device(), c.grid, c.n_out), sum(device(), layer.d_to);
    const auto weights = test::to_device<shared::ConvWeights>(device(), layer.weights);
    const auto bias = test::to_device<shared::ConvBias>(device(), layer.bias);
    conv.forward(stream, from.slice(), weights.address(), bias.address(), to.slice());
    conv.forward(stream, from.slice(), weights.address(), {}, sum.slice(), true);
    stream.finish();
    EXPECT_LT(worst_error(to.read(), reference::convolve(layer.from, layer.weights, layer.bias, c.n_out, int(c.taps))), test::kLayer);
    test::ImageBatch expected = reference::convolve(layer.from, layer.weights, {}, c.n_out, int(c.taps));
    for (std::size_t i = 0; i < expected.values.size(); ++i) expected.values[i] += layer.d_to.values[i];
    EXPECT_LT(worst_error(sum.read(), expected), test::kLayer);
}

/// Both derivatives, where gradients of images are `scale` times what they are and those of weights are not.
void expect_derivatives(Device& device, const Case& c, float scale) {
    const HalfLayer layer(c);
    Conv conv(device, c.taps, Precision::fp16);
    conv.scale_gradients(scale);
    conv.reserve(device, conv.partial_floats(c.grid, std::uint32_t(c.n_in), std::uint32_t(c.n_out)));
    Stream stream(device);
    const OnDevice from(device, layer.from), d_to(device, layer.d_to), d_from = OnDevice::unwritten(device, c.grid, c.n_in);
    const auto weights = test::to_device<shared::ConvWeights>(device, layer.weights);
    std::vector<double> guarded(layer.weights.size() + 1, std::nan(""));
    const auto d_weights = test::to_device<shared::ConvWeights>(device, guarded),
               again = test::to_device<shared::ConvWeights>(device, guarded);
    conv.input_vjp(stream, d_to.slice(), weights.address(), d_from.slice());
    for (const auto* d : {&d_weights, &again}) conv.weights_vjp(stream, from.slice(), d_to.slice(), d->address());
    stream.finish();
    EXPECT_LT(worst_error(d_from.read(), reference::convolve_input_vjp(layer.d_to, layer.weights, c.n_in, int(c.taps))), test::kLayer);
    std::vector<double> actual = test::doubles(d_weights), repeated = test::doubles(again);
    EXPECT_TRUE(std::isnan(actual.back())) << "wrote past the end";
    actual.pop_back(), repeated.pop_back();
    for (double& x : actual) x *= double(scale);
    EXPECT_LT(worst_error(actual, reference::convolve_weights_vjp(layer.from, layer.d_to, int(c.taps))), test::kLayer);
    for (double& x : repeated) x *= double(scale);
    EXPECT_EQ(actual, repeated);   // a fixed order
}

TEST_P(MatrixSizes, Derivatives) { expect_derivatives(device(), GetParam(), 1.0f); }
TEST_P(MatrixSizes, DerivativesOfScaledGradients) { expect_derivatives(device(), GetParam(), std::exp2(24.0f)); }

TEST_F(MatrixTest, InputGradientsAreAdded) {
    const Case c{9, {2, 5, 13}, 17, 9};
    const HalfLayer layer(c);
    Conv conv(device(), c.taps, Precision::fp16);
    conv.scale_gradients(64.0f);
    Stream stream(device());
    const OnDevice d_to(device(), layer.d_to), sum(device(), layer.from);
    const auto weights = test::to_device<shared::ConvWeights>(device(), layer.weights);
    conv.input_vjp(stream, d_to.slice(), weights.address(), sum.slice(), true);
    stream.finish();
    test::ImageBatch expected = reference::convolve_input_vjp(layer.d_to, layer.weights, c.n_in, int(c.taps));
    for (std::size_t i = 0; i < expected.values.size(); ++i) expected.values[i] += layer.from.values[i];
    EXPECT_LT(worst_error(sum.read(), expected), test::kLayer);
}

/// Numbers that no half is: within half a step of one, 2^-11 of it, each. Which way is the device's.
TEST_F(MatrixTest, OperandsAreRounded) {
    const Case c{9, {1, 9, 31}, 16, 17};
    const test::ImageBatch images = test::random_images(c.grid, c.n_in, 1);
    const std::vector<double> values = test::random_floats(std::size_t(c.n_in) * c.n_out * 9, 3);
    Conv conv(device(), 9, Precision::fp16);
    Stream stream(device());
    const OnDevice from(device(), images), to = OnDevice::unwritten(device(), c.grid, c.n_out);
    const auto weights = test::to_device<shared::ConvWeights>(device(), values);
    conv.forward(stream, from.slice(), weights.address(), {}, to.slice());
    stream.finish();
    const double error = worst_error(to.read(), reference::convolve(images, values, {}, c.n_out, 9));
    EXPECT_LT(error, 1e-3);
    EXPECT_GT(error, test::kLayer) << "not rounded";
}

TEST_F(MatrixTest, LargeNumbersSaturateAndWhatIsNoNumberStaysNone) {
    test::ImageBatch images(1, 1, 1, 3);
    images.values = {1e6, -1e6, std::nan("")};
    Conv conv(device(), 1, Precision::fp16);
    Stream stream(device());
    const OnDevice from(device(), images), to = OnDevice::unwritten(device(), test::grid_of(images), 1);
    const auto weights = test::to_device<shared::ConvWeights>(device(), {0.5});
    conv.forward(stream, from.slice(), weights.address(), {}, to.slice());
    stream.finish();
    const test::ImageBatch seen = to.read();
    EXPECT_EQ(seen.values[0], 32752.0);
    EXPECT_EQ(seen.values[1], -32752.0);
    EXPECT_TRUE(std::isnan(seen.values[2]));
}

class MatrixErrorTest : public test::DeviceTest {};

TEST_F(MatrixErrorTest, WithoutMatrixUnitsOneLineSaysWhatIsMissing) {
    const std::string& missing = device().info().why_not_matrices;
    if (missing.empty()) GTEST_SKIP() << "the device has matrix units";
    using testing::AllOf, testing::HasSubstr;
    EXPECT_THAT([&] { Conv(device(), 9, Precision::fp16); },
                testing::ThrowsMessage<DeviceError>(AllOf(HasSubstr("refine.precision=fp16"), HasSubstr("missing " + missing),
                                                          HasSubstr("; set refine.precision=fp32"), testing::Not(HasSubstr("\n")))));
}

TEST(Precision, HasTwoNames) {
    EXPECT_EQ(refine::find_precision("fp32"), Precision::fp32);
    EXPECT_EQ(refine::find_precision("fp16"), Precision::fp16);
    EXPECT_THROW(refine::find_precision("fp8"), UsageError);
}

TEST(Precision, GradientsOfAMeanAreScaledByAPowerOfTwo) {
    EXPECT_EQ(refine::gradient_scale(0), 1.0f);
    EXPECT_EQ(refine::gradient_scale(1), 1.0f);
    EXPECT_EQ(refine::gradient_scale(1000), 1024.0f);
    EXPECT_EQ(refine::gradient_scale(66 * 1030), 65536.0f);
}

}  // namespace
}  // namespace relidar
