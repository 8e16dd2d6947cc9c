// SPDX-License-Identifier: Apache-2.0
// Kernels whose images are halves beside the same kernels with floats, which the other tests of this folder compare with the double
// reference. Their inputs are numbers that a half holds and they compute with floats, so what they write is what floats become when they
// are rounded, to either side; and what is no image, gradients of parameters and moments, is the same to the bit.
#include <cmath>
#include <functional>

#include <gmock/gmock.h>

#include <relidar/error.hpp>

#include "../support/device.hpp"
#include "gpu/stream.hpp"
#include "images.hpp"
#include "refine/attention.hpp"
#include "refine/conv.hpp"
#include "refine/drop_inputs.hpp"
#include "refine/drop_loss.hpp"
#include "refine/norm.hpp"
#include "refine/resample.hpp"

namespace relidar {
namespace {

using refine::Grid, refine::Precision, refine::Storage;
using test::ImageBatch, test::OnDevice;

ImageBatch rounded_images(const Grid& grid, int channels, std::uint64_t seed) {
    ImageBatch images = test::random_images(grid, channels, seed);
    for (double& x : images.values) x = double(glm::unpackHalf1x16(glm::packHalf1x16(float(x))));
    return images;
}

/// Distance of a half to the next one that is larger in magnitude.
double step_of_half(double x) { return std::exp2(std::max(std::floor(std::log2(std::max(std::abs(x), 1e-30))), -14.0) - 10.0); }

/// Images that a layer has written, and other results.
struct Made {
    std::vector<ImageBatch> images;
    std::vector<std::vector<double>> others;
};

class HalvesTest : public test::DeviceTest, public testing::WithParamInterface<Grid> {
protected:
    void SetUp() override {
        test::DeviceTest::SetUp();
        if (IsSkipped() || HasFailure()) return;
        if (!device().info().why_not_halves.empty()) GTEST_SKIP() << "no arrays of halves: missing " << device().info().why_not_halves;
    }

    void expect_rounded(const std::function<Made(Storage, Stream&)>& make) {
        Stream stream(device());
        const Made floats = make(Storage::fp32, stream), halves = make(Storage::fp16, stream);
        EXPECT_EQ(halves.others, floats.others);
        std::size_t n_rounded = 0;
        ASSERT_EQ(halves.images.size(), floats.images.size());
        for (std::size_t k = 0; k < halves.images.size(); ++k)
            for (std::size_t i = 0; i < halves.images[k].values.size(); ++i) {
                const double found = halves.images[k].values[i], expected = floats.images[k].values[i];
                ASSERT_LT(std::abs(found - expected), step_of_half(expected)) << "value " << i << " of image " << k;
                n_rounded += found != expected;
            }
        EXPECT_GT(n_rounded, 0u) << "the images are not of halves";
    }
};

INSTANTIATE_TEST_SUITE_P(Sizes, HalvesTest, testing::Values(Grid{1, 66, 1030}, Grid{3, 5, 13}, Grid{2, 8, 70}), [](const auto& tested) {
    return std::to_string(tested.param.n) + "x" + std::to_string(tested.param.rows) + "x" + std::to_string(tested.param.columns);
});

TEST_P(HalvesTest, Convolutions) {
    const Grid grid = GetParam();
    const int n_in = 9, n_out = 11;
    std::vector<std::pair<std::uint32_t, Precision>> layers{{1u, Precision::fp32}, {9u, Precision::fp32}};
    if (device().info().why_not_matrices.empty()) layers.insert(layers.end(), {{1u, Precision::fp16}, {9u, Precision::fp16}});
    for (const auto& [taps, precision] : layers) {
        const auto weights = test::to_device<shared::ConvWeights>(device(), test::random_floats(std::size_t(n_in * n_out) * taps, 3));
        const auto bias = test::to_device<shared::ConvBias>(device(), test::random_floats(std::size_t(n_out), 4));
        expect_rounded([&](Storage storage, Stream& stream) -> Made {
            refine::Conv conv(device(), taps, precision, storage);
            conv.reserve(device(), conv.partial_floats(grid, n_in, n_out));
            const OnDevice from(device(), rounded_images(grid, n_in, 1), storage), d_to(device(), rounded_images(grid, n_out, 2), storage);
            const OnDevice to = OnDevice::unwritten(device(), grid, n_out, 1, 2, storage);
            const OnDevice sum(device(), rounded_images(grid, n_out, 5), storage);
            const OnDevice d_from = OnDevice::unwritten(device(), grid, n_in, 0, 1, storage);
            const auto d_weights = test::to_device<shared::ConvWeights>(device(), std::vector<double>(weights.size()));
            conv.forward(stream, from.slice(), weights.address(), bias.address(), to.slice());
            conv.forward(stream, from.slice(), weights.address(), {}, sum.slice(), true);
            conv.input_vjp(stream, d_to.slice(), weights.address(), d_from.slice());
            conv.weights_vjp(stream, from.slice(), d_to.slice(), d_weights.address());
            stream.finish();
            return {{to.read(), sum.read(), d_from.read()}, {test::doubles(d_weights)}};
        });
    }
}

TEST_P(HalvesTest, Normalisations) {
    const Grid grid = GetParam();
    const int channels = 9;
    const std::vector<double> beta = test::random_floats(channels, 5, 0.5), gamma = test::random_floats(channels, 6);
    expect_rounded([&](Storage storage, Stream& stream) -> Made {
        refine::Norm norm(device(), storage);
        norm.reserve(device(), channels, grid);
        refine::NormState state(device(), channels);
        state.dropout = 0.3f;
        state.dropout_key = 7;
        const auto beta_gamma = test::pairs_to_device<shared::BetaGamma>(device(), beta, gamma);
        const auto running = test::pairs_to_device<shared::RunningMoments>(device(), beta, beta);
        const OnDevice from(device(), rounded_images(grid, channels, 1), storage);
        const OnDevice d_to(device(), rounded_images(grid, channels, 2), storage);
        const OnDevice to = OnDevice::unwritten(device(), grid, channels, 1, 2, storage);
        const OnDevice d_from(device(), rounded_images(grid, channels, 3), storage);
        const Array<float> d_parameters = test::to_device(device(), std::vector<double>(2 * channels));
        const auto d_bias = test::to_device<shared::ConvBias>(device(), std::vector<double>(channels));
        norm.forward(stream, from.slice(), {beta_gamma.address(), running.address()}, state, to.slice());
        norm.vjp(stream, from.slice(), state, d_to.slice(), d_from.slice(), {d_parameters, 0}, true);
        norm.bias_vjp(stream, d_to.slice(), d_bias.address());
        stream.finish();
        return {{to.read(), d_from.read()}, {test::doubles(d_parameters), test::doubles(d_bias)}};
    });
}

TEST_P(HalvesTest, ChangesOfSize) {
    const Grid grid = GetParam(), small = refine::pooled(grid);
    const int channels = 3;
    expect_rounded([&](Storage storage, Stream& stream) -> Made {
        refine::Resample resample(device(), storage);
        const OnDevice large(device(), rounded_images(grid, channels, 1), storage);
        const OnDevice d_small(device(), rounded_images(small, channels, 2), storage);
        const OnDevice pooled = OnDevice::unwritten(device(), small, channels, 1, 2, storage),
                       upsampled = OnDevice::unwritten(device(), grid, channels, 1, 0, storage),
                       d_pooled(device(), rounded_images(grid, channels, 3), storage),
                       d_upsampled = OnDevice::unwritten(device(), small, channels, 2, 0, storage);
        resample.pool(stream, large.slice(), pooled.slice());
        resample.pool_vjp(stream, large.slice(), d_small.slice(), d_pooled.slice());
        resample.upsample(stream, d_small.slice(), upsampled.slice());
        resample.upsample_vjp(stream, large.slice(), d_upsampled.slice());
        stream.finish();
        return {{pooled.read(), d_pooled.read(), upsampled.read(), d_upsampled.read()}, {}};
    });
}

/// The steps of attention are images of their own, so only the products of the first are floats rounded once: what follows is near.
TEST_P(HalvesTest, Attention) {
    const Grid grid{GetParam().n, 3, 11};
    const int channels = 8;
    const std::uint32_t heads = 2;
    const auto made = [&](Storage storage) {
        Stream stream(device());
        refine::Attention attention(device(), heads, storage);
        refine::AttentionState state = attention.make_state(device(), grid, true);
        const OnDevice qkv(device(), rounded_images(grid, 3 * channels, 1), storage);
        const OnDevice d_to(device(), rounded_images(grid, channels, 2), storage);
        const OnDevice to = OnDevice::unwritten(device(), grid, channels, 1, 2, storage),
                       d_qkv = OnDevice::unwritten(device(), grid, 3 * channels, 0, 1, storage);
        attention.forward(stream, qkv.slice(), state, to.slice());
        attention.vjp(stream, qkv.slice(), state, d_to.slice(), d_qkv.slice());
        stream.finish();
        return std::vector<ImageBatch>{to.read(), d_qkv.read()};
    };
    const std::vector<ImageBatch> floats = made(Storage::fp32), halves = made(Storage::fp16);
    for (std::size_t k = 0; k < floats.size(); ++k) {
        EXPECT_LT(test::worst_error(halves[k], floats[k]), 3e-3);
        EXPECT_NE(halves[k].values, floats[k].values) << "the images are not of halves";
    }
}

TEST_P(HalvesTest, Inputs) {
    const Grid grid = GetParam();
    DropNetwork network;
    network.inputs = {"log_range", "intensity", "drop_logit"};
    network.normalisation = {0.7f, 0.1f, 1.3f, -2.0f, 1.0f, 0.3f};
    std::vector<DropImage> samples;
    for (std::uint64_t i = 0; i < grid.n; ++i) {
        const std::vector<double> channels = rounded_images({1, grid.rows, grid.columns}, 3, i).values;
        samples.push_back({int(grid.rows), int(grid.columns), {channels.begin(), channels.end()}, {}});
    }
    expect_rounded([&](Storage storage, Stream& stream) -> Made {
        refine::DropInputs inputs(device(), network, storage);
        inputs.keep(device(), samples);
        std::vector<refine::DropInputs::Chosen> chosen;
        for (std::uint32_t i = 0; i < grid.n; ++i) chosen.push_back({grid.n - 1 - i, 3 * i});
        const refine::Tensor images(device(), 3, grid, storage, "images");
        inputs.make(stream, chosen, images);
        stream.finish();
        ImageBatch made(int(grid.n), 3, int(grid.rows), int(grid.columns));
        const std::vector<float> values = test::download(images);
        made.values.assign(values.begin(), values.end());
        return {{made}, {test::doubles(inputs.start())}};
    });
}

TEST_P(HalvesTest, LossAndItsScale) {
    const Grid grid = GetParam();
    const ImageBatch logits = rounded_images(grid, 1, 1);
    std::vector<double> targets(grid.all_pixels());
    for (std::size_t i = 0; i < targets.size(); ++i) targets[i] = double(i % 3) - 1.0;   // a third is not known
    const auto target = test::to_device<shared::DropTargets>(device(), targets);
    const float scale = refine::gradient_scale(grid.all_pixels());
    expect_rounded([&](Storage storage, Stream& stream) -> Made {
        refine::DropLoss loss(device(), grid.all_pixels(), storage);
        const OnDevice logit(device(), logits, 0, 0, storage), d_logit = OnDevice::unwritten(device(), grid, 1, 0, 0, storage);
        const auto probability = test::to_device<shared::DropProbabilities>(device(), targets);
        loss.run(stream, grid.all_pixels(),
                 {.logit = logit.slice().view.values.as<shared::DropLogits>(), .target = target.address(),
                  .d_logit = d_logit.slice().view.values.as<shared::DropLogitGradients>(), .probability = probability.address()},
                 grid.all_pixels() * 2 / 3, scale);
        stream.finish();
        const refine::DropScore score = loss.score(grid.all_pixels());
        return {{d_logit.read()}, {test::doubles(probability), {score.entropy, score.accuracy}}};
    });
}

/// What no half can be ends at the largest one; what is no number stays none.
TEST_P(HalvesTest, LargeNumbersSaturateAndWhatIsNoNumberStaysNone) {
    ImageBatch images(1, 1, 1, 3);
    images.values = {60000.0, -60000.0, std::nan("")};
    Stream stream(device());
    refine::Conv conv(device(), 1, Precision::fp32, Storage::fp16);
    const OnDevice from(device(), images, Storage::fp16), to = OnDevice::unwritten(device(), test::grid_of(images), 1, 1, 2, Storage::fp16);
    const auto weights = test::to_device<shared::ConvWeights>(device(), {2.0});
    conv.forward(stream, from.slice(), weights.address(), {}, to.slice());
    stream.finish();
    const ImageBatch seen = to.read();
    EXPECT_EQ(seen.values[0], 65504.0);
    EXPECT_EQ(seen.values[1], -65504.0);
    EXPECT_TRUE(std::isnan(seen.values[2]));
}

TEST(Storage, HasTwoNames) {
    EXPECT_EQ(refine::find_storage("fp32"), Storage::fp32);
    EXPECT_EQ(refine::find_storage("fp16"), Storage::fp16);
    EXPECT_THROW(refine::find_storage("fp8"), UsageError);
}

}  // namespace
}  // namespace relidar
