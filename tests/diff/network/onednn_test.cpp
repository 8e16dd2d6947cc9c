// SPDX-License-Identifier: Apache-2.0
// Compares the layers of the ray-drop network with oneDNN, which does not support a ring
// of columns.
#include <onednn_primitive.hpp>

#include "../../support/device.hpp"
#include "diff/network/conv.hpp"
#include "diff/network/norm.hpp"
#include "diff/network/resample.hpp"
#include "gpu/stream.hpp"
#include "images.hpp"

namespace relidar {
namespace {

using dnnl::algorithm, dnnl::memory, dnnl::prop_kind;
using network::ImageBatchSize;
using test::ImageBatch, test::OnDevice, test::compute_worst_error;

class OneDnnTest : public test::DeviceTest {
protected:
    dnnl::engine engine_{dnnl::engine::kind::cpu, 0};
    dnnl::stream stream_{engine_};

    static memory::desc describe_images(const ImageBatch& images) {
        return {{images.n, images.channels, images.rows, images.columns},
                memory::data_type::f32,
                memory::format_tag::nchw};
    }
    memory given(const memory::desc& desc, const std::vector<double>& values) {
        memory result(desc, engine_);
        std::copy(values.begin(), values.end(), static_cast<float*>(result.get_data_handle()));
        return result;
    }
    memory given(const ImageBatch& images) { return given(describe_images(images), images.values); }
    memory empty(const memory::desc& desc) { return memory(desc, engine_); }
    static std::vector<double> values_of(const memory& from, std::size_t count) {
        const auto* values = static_cast<const float*>(from.get_data_handle());
        return {values, values + count};
    }
    static ImageBatch get_images(const memory& from, ImageBatch shape) {
        shape.values = values_of(from, shape.values.size());
        return shape;
    }
    void execute(const dnnl::primitive& primitive, const std::unordered_map<int, memory>& arguments) {
        primitive.execute(stream_, arguments);
        stream_.wait();
    }
};

ImageBatch pad_images(const ImageBatch& images, int margin) {
    ImageBatch result(images.n, images.channels, images.rows, images.columns + 2 * margin);
    result.for_each([&](int image, int c, int y, int x) {
        result.at(image, c, y, x) = images.at(image, c, y, (x - margin + images.columns) % images.columns);
    });
    return result;
}

/// Computes the transpose of pad_images(): adds the gradients of the padded columns to
/// the columns from which they were copied.
ImageBatch folded(const ImageBatch& images, int margin) {
    ImageBatch result(images.n, images.channels, images.rows, images.columns - 2 * margin);
    images.for_each([&](int image, int c, int y, int x) {
        result.at(image, c, y, (x - margin + result.columns) % result.columns) += images.at(image, c, y, x);
    });
    return result;
}

/// Removes `margin` columns on both sides, or adds zeros if `margin` is negative.
ImageBatch crop_images(const ImageBatch& images, int margin) {
    ImageBatch result(images.n, images.channels, images.rows, images.columns - 2 * margin);
    result.for_each([&](int image, int c, int y, int x) {
        if (x + margin >= 0 && x + margin < images.columns)
            result.at(image, c, y, x) = images.at(image, c, y, x + margin);
    });
    return result;
}

struct ConvAnswers {
    ImageBatch to, d_from;
    std::vector<double> d_weights, d_bias;
};

class OneDnnConv : public OneDnnTest, public testing::WithParamInterface<std::uint32_t> {
protected:
    ConvAnswers ask(const ImageBatch& plain, const std::vector<double>& weights,
                    const std::vector<double>& bias, const ImageBatch& d_to, int taps) {
        const int side = taps == 9 ? 3 : 1, reach = side / 2;
        const ImageBatch from = plain.circular ? pad_images(plain, reach) : crop_images(plain, -reach);
        const memory::desc of_from = describe_images(from), of_to = describe_images(d_to),
                           of_weights({d_to.channels, plain.channels, side, side}, memory::data_type::f32,
                                      memory::format_tag::oihw),
                           of_bias({d_to.channels}, memory::data_type::f32, memory::format_tag::x);
        const memory::dims strides{1, 1}, ends{reach, 0};
        const auto forward = onednn::describe<dnnl::convolution_forward>(
            engine_, prop_kind::forward_training, algorithm::convolution_direct, of_from, of_weights, of_bias,
            of_to, strides, ends, ends);
        const auto by_input = onednn::describe_backward<dnnl::convolution_backward_data>(
            engine_, forward, algorithm::convolution_direct, of_from, of_weights, of_to, strides, ends, ends);
        const auto by_weights = onednn::describe_backward<dnnl::convolution_backward_weights>(
            engine_, forward, algorithm::convolution_direct, of_from, of_weights, of_bias, of_to, strides,
            ends, ends);
        memory in = given(from), w = given(of_weights, weights), b = given(of_bias, bias),
               d_output = given(d_to), out = empty(of_to), d_in = empty(of_from), d_w = empty(of_weights),
               d_b = empty(of_bias);
        execute(dnnl::convolution_forward(forward),
                {{DNNL_ARG_SRC, in}, {DNNL_ARG_WEIGHTS, w}, {DNNL_ARG_BIAS, b}, {DNNL_ARG_DST, out}});
        execute(dnnl::convolution_backward_data(by_input),
                {{DNNL_ARG_DIFF_DST, d_output}, {DNNL_ARG_WEIGHTS, w}, {DNNL_ARG_DIFF_SRC, d_in}});
        execute(dnnl::convolution_backward_weights(by_weights), {{DNNL_ARG_SRC, in},
                                                                 {DNNL_ARG_DIFF_DST, d_output},
                                                                 {DNNL_ARG_DIFF_WEIGHTS, d_w},
                                                                 {DNNL_ARG_DIFF_BIAS, d_b}});
        const ImageBatch d_padded = get_images(d_in, from);
        return {get_images(out, d_to),
                plain.circular ? folded(d_padded, reach) : crop_images(d_padded, reach),
                values_of(d_w, weights.size()), values_of(d_b, bias.size())};
    }
};
INSTANTIATE_TEST_SUITE_P(Refine, OneDnnConv, testing::Values(1u, 9u));

TEST_P(OneDnnConv, Agrees) {
    const std::uint32_t taps = GetParam();
    struct Sizes {
        ImageBatchSize grid;
        int n_in, n_out;
    };
    for (const Sizes& size : {Sizes{{4, 9, 37}, 9, 17}, Sizes{{1, 66, 1030}, 10, 16}, Sizes{{2, 2, 13}, 3, 1},
                              Sizes{{4, 9, 37, false}, 9, 17}}) {
        const ImageBatch values = test::make_random_images(size.grid, size.n_in, 1),
                         d_output = test::make_random_images(size.grid, size.n_out, 2);
        const std::vector<double> weights =
                                      test::make_random_floats(std::size_t(size.n_in) * size.n_out * taps, 3),
                                  bias = test::make_random_floats(std::size_t(size.n_out), 4);
        const ConvAnswers expected = ask(values, weights, bias, d_output, int(taps));
        network::Convolution conv(device(), taps);
        network::Norm norm(device());
        norm.reserve_sums(std::uint32_t(size.n_out), size.grid);
        conv.reserve_weight_sums(
            device(), conv.n_partial_sums(size.grid, std::uint32_t(size.n_in), std::uint32_t(size.n_out)));
        Stream stream(device());
        const OnDevice from(device(), values), d_to(device(), d_output),
            to = OnDevice::make_unwritten(device(), size.grid, size.n_out),
            d_from = OnDevice::make_unwritten(device(), size.grid, size.n_in);
        const auto w = test::to_device<shared::ConvWeights>(device(), weights);
        const auto b = test::to_device<shared::ConvBias>(device(), bias);
        const Array<float, shared::ConvWeights> d_w(device(), weights.size(), "gradient");
        const Array<float, shared::ConvBias> d_b(device(), bias.size(), "gradient");
        conv.run_convolution(stream, from.slice(), w.address(), b.address(), to.slice());
        conv.input_vjp(stream, d_to.slice(), w.address(), d_from.slice());
        conv.weights_vjp(stream, from.slice(), d_to.slice(), d_w.address());
        norm.bias_vjp(stream, d_to.slice(), d_b.address());
        stream.submit_and_wait();
        EXPECT_LT(compute_worst_error(to.read(), expected.to), test::kLayer);
        EXPECT_LT(compute_worst_error(d_from.read(), expected.d_from), test::kLayer);
        EXPECT_LT(compute_worst_error(test::to_doubles(d_w), expected.d_weights), test::kLayer);
        EXPECT_LT(compute_worst_error(test::to_doubles(d_b), expected.d_bias), test::kLayer);
    }
}

struct NormAnswers {
    ImageBatch to, d_from;
    std::vector<double> d_gamma_beta;  ///< all gammas, then all betas
};

class OneDnnNorm : public OneDnnTest {
protected:
    /// Runs batch normalisation in oneDNN and applies ReLU by hand.
    NormAnswers ask(const ImageBatch& from, const std::vector<double>& gamma_beta, const ImageBatch& d_to) {
        const memory::desc of_images = describe_images(from);
        const auto flags = dnnl::normalization_flags::use_scale | dnnl::normalization_flags::use_shift;
        const auto forward = onednn::describe_norm(engine_, of_images, 1e-5f, flags);
        const auto backward = onednn::describe_norm_backward(engine_, forward, of_images, 1e-5f, flags);
        const memory::desc of_channels({from.channels}, memory::data_type::f32, memory::format_tag::x);
        const auto beta = gamma_beta.begin() + from.channels;
        memory in = given(from), scale = given(of_channels, {gamma_beta.begin(), beta}),
               shift = given(of_channels, {beta, gamma_beta.end()}), out = empty(of_images),
               d_in = empty(of_images), mean = empty(forward.mean_desc()),
               variance = empty(forward.variance_desc()), d_scale = empty(of_channels),
               d_shift = empty(of_channels);
        execute(dnnl::batch_normalization_forward(forward), {{DNNL_ARG_SRC, in},
                                                             {DNNL_ARG_SCALE, scale},
                                                             {DNNL_ARG_SHIFT, shift},
                                                             {DNNL_ARG_MEAN, mean},
                                                             {DNNL_ARG_VARIANCE, variance},
                                                             {DNNL_ARG_DST, out}});
        ImageBatch to = get_images(out, from), d_output = d_to;
        for (std::size_t i = 0; i < to.values.size(); ++i) {
            if (to.values[i] <= 0.0) d_output.values[i] = 0.0;
            to.values[i] = std::max(to.values[i], 0.0);
        }
        memory d_out = given(d_output);
        execute(dnnl::batch_normalization_backward(backward), {
            {DNNL_ARG_SRC, in}, {DNNL_ARG_MEAN, mean}, {DNNL_ARG_VARIANCE, variance},
                {DNNL_ARG_DIFF_DST, d_out}, {DNNL_ARG_SCALE, scale},
#if DNNL_VERSION_MAJOR < 3  // oneDNN 2 requires this unused argument, oneDNN 3 rejects it
                {DNNL_ARG_SHIFT, shift},
#endif
                {DNNL_ARG_DIFF_SRC, d_in}, {DNNL_ARG_DIFF_SCALE, d_scale}, {
                DNNL_ARG_DIFF_SHIFT, d_shift
            }
        });
        std::vector<double> d_gamma_beta = values_of(d_scale, std::size_t(from.channels));
        const std::vector<double> d_beta = values_of(d_shift, std::size_t(from.channels));
        d_gamma_beta.insert(d_gamma_beta.end(), d_beta.begin(), d_beta.end());
        return {to, get_images(d_in, from), d_gamma_beta};
    }
};

TEST_F(OneDnnNorm, Agrees) {
    for (const ImageBatchSize& grid : {ImageBatchSize{4, 33, 65}, ImageBatchSize{1, 66, 1030}}) {
        const int channels = 9;
        const ImageBatch values = test::make_random_images(grid, channels, 1, 2.0, 0.7);
        ImageBatch d_output = test::make_random_images(grid, channels, 2);
        const std::vector<double> beta = test::make_random_floats(channels, 5, 0.5),
                                  gamma = test::make_random_floats(channels, 6);
        test::exclude_kinks(d_output, values, beta, gamma);
        std::vector<double> gamma_beta = gamma;
        gamma_beta.insert(gamma_beta.end(), beta.begin(), beta.end());
        const NormAnswers expected = ask(values, gamma_beta, d_output);
        network::Norm norm(device());
        norm.reserve_sums(channels, grid);
        network::NormState state(device(), channels);
        const auto parameters = test::upload_pairs<shared::BetaGamma>(device(), beta, gamma);
        const auto running = test::upload_pairs<shared::RunningMoments>(device(), beta, gamma);
        const Array<float> d_parameters(device(), 2 * channels, "gradient");
        Stream stream(device());
        const OnDevice from(device(), values), d_to(device(), d_output),
            to = OnDevice::make_unwritten(device(), grid, channels),
            d_from = OnDevice::make_unwritten(device(), grid, channels);
        norm.normalise_batch(stream, from.slice(), {parameters.address(), running.address()}, state,
                             to.slice());
        norm.norm_vjp(stream, from.slice(), state, d_to.slice(), d_from.slice(), {d_parameters, 0});
        stream.submit_and_wait();
        EXPECT_LT(compute_worst_error(to.read(), expected.to), test::kLayer);
        EXPECT_LT(compute_worst_error(d_from.read(), expected.d_from), 2e-5);
        const std::vector<double> d = test::to_doubles(d_parameters);
        std::vector<double> d_gamma_beta;
        for (std::size_t k = 0; k < channels; ++k) d_gamma_beta.push_back(d[2 * k + 1]);
        for (std::size_t k = 0; k < channels; ++k) d_gamma_beta.push_back(d[2 * k]);
        EXPECT_LT(compute_worst_error(d_gamma_beta, expected.d_gamma_beta), 2e-5);
    }
}

class OneDnnResample : public OneDnnTest {};

TEST_F(OneDnnResample, PoolingAgrees) {
    for (const ImageBatchSize& grid : {ImageBatchSize{4, 7, 13}, ImageBatchSize{1, 66, 1030}}) {
        const ImageBatch values = test::make_random_images(grid, 3, 1),
                         d_output = test::make_random_images(network::half_size(grid), 3, 2);
        const memory::desc of_from = describe_images(values), of_to = describe_images(d_output);
        const memory::dims two{2, 2}, none{0, 0};
        const auto forward = onednn::describe<onednn::pooling_forward>(engine_, prop_kind::forward_training,
                                                                       algorithm::pooling_max, of_from, of_to,
                                                                       two, two, none, none, none);
        const auto backward = onednn::describe_backward<onednn::pooling_backward>(
            engine_, forward, algorithm::pooling_max, of_from, of_to, two, two, none, none, none);
        memory in = given(values), d_out = given(d_output), out = empty(of_to), d_in = empty(of_from),
               which = empty(forward.workspace_desc());
        execute(onednn::pooling_forward(forward),
                {{DNNL_ARG_SRC, in}, {DNNL_ARG_DST, out}, {DNNL_ARG_WORKSPACE, which}});
        execute(onednn::pooling_backward(backward),
                {{DNNL_ARG_DIFF_DST, d_out}, {DNNL_ARG_WORKSPACE, which}, {DNNL_ARG_DIFF_SRC, d_in}});
        network::Resampling resample(device());
        Stream stream(device());
        const OnDevice from(device(), values), d_to(device(), d_output),
            to = OnDevice::make_unwritten(device(), network::half_size(grid), 3),
            d_from(device(), ImageBatch(values.n, 3, values.rows, values.columns));
        resample.max_pool(stream, from.slice(), to.slice());
        resample.max_pool_vjp(stream, from.slice(), d_to.slice(), d_from.slice());
        stream.submit_and_wait();
        EXPECT_EQ(to.read().values, get_images(out, d_output).values);
        EXPECT_EQ(d_from.read().values, get_images(d_in, values).values);
    }
}

/// Compares upsampling. The number of columns is doubled, because padding would otherwise
/// move the pixel centres. Rows may have any size.
TEST_F(OneDnnResample, UpsamplingAgrees) {
    struct Sizes {
        ImageBatchSize small, large;
    };
    for (const Sizes& size : {Sizes{{4, 3, 13}, {4, 7, 26}}, Sizes{{1, 33, 515}, {1, 66, 1030}},
                              Sizes{{4, 3, 13, false}, {4, 7, 26, false}}}) {
        const ImageBatch values = test::make_random_images(size.small, 3, 1),
                         d_output = test::make_random_images(size.large, 3, 2);
        const int margin = size.small.circular ? 1 : 0;  // oneDNN clamps columns
        const ImageBatch wide = pad_images(values, margin),
                         wide_gradient = crop_images(d_output, -2 * margin);
        const memory::desc of_from = describe_images(wide), of_to = describe_images(wide_gradient);
        const auto forward = onednn::describe<dnnl::resampling_forward>(
            engine_, prop_kind::forward_training, algorithm::resampling_linear, of_from, of_to);
        const auto backward = onednn::describe_backward<dnnl::resampling_backward>(
            engine_, forward, algorithm::resampling_linear, of_from, of_to);
        memory in = given(wide), d_out = given(wide_gradient), out = empty(of_to), d_in = empty(of_from);
        execute(dnnl::resampling_forward(forward), {{DNNL_ARG_SRC, in}, {DNNL_ARG_DST, out}});
        execute(dnnl::resampling_backward(backward), {{DNNL_ARG_DIFF_DST, d_out}, {DNNL_ARG_DIFF_SRC, d_in}});
        network::Resampling resample(device());
        Stream stream(device());
        const OnDevice from(device(), values), d_to(device(), d_output),
            to = OnDevice::make_unwritten(device(), size.large, 3),
            d_from = OnDevice::make_unwritten(device(), size.small, 3);
        resample.upsample(stream, from.slice(), to.slice());
        resample.upsample_vjp(stream, d_to.slice(), d_from.slice());
        stream.submit_and_wait();
        // tolerance: single precision computes a position among 1030 pixels with an error
        // of about 3e-5
        EXPECT_LT(compute_worst_error(to.read(), crop_images(get_images(out, wide_gradient), 2 * margin)),
                  5e-5);
        EXPECT_LT(compute_worst_error(d_from.read(), folded(get_images(d_in, wide), margin)), 5e-5);
    }
}

}  // namespace
}  // namespace relidar
