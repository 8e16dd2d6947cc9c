// SPDX-License-Identifier: Apache-2.0
// Compares the convolution kernels diff/network/conv, conv_weights and sum_parts with the
// double reference.
#include "diff/network/conv.hpp"

#include "../../support/device.hpp"
#include "gpu/stream.hpp"
#include "images.hpp"

namespace relidar {
namespace {

using network::Convolution, network::ImageBatchSize;
using test::OnDevice, test::compute_worst_error;

struct Case {
    std::uint32_t taps;
    network::ImageBatchSize grid;
    int n_in, n_out;
};

void PrintTo(const Case& test_case, std::ostream* out) {
    *out << test_case.taps << " taps, " << test_case.grid.n << "x" << test_case.grid.rows << "x"
         << test_case.grid.columns << ", " << test_case.n_in << " -> " << test_case.n_out;
}

class ConvSizes : public test::DeviceTest, public testing::WithParamInterface<Case> {};
INSTANTIATE_TEST_SUITE_P(Refine, ConvSizes,
                         testing::Values(Case{9, {1, 66, 1030}, 9, 3}, Case{1, {1, 66, 1030}, 9, 3},
                                         Case{9, {1, 5, 13}, 1, 1}, Case{9, {4, 7, 9}, 3, 17},
                                         Case{9, {4, 1, 3}, 17, 9}, Case{9, {1, 2, 1}, 3, 8},
                                         Case{9, {1, 3, 2}, 8, 16}, Case{9, {1, 2, 65}, 9, 9},
                                         Case{9, {4, 9, 31}, 16, 17}, Case{1, {4, 5, 13}, 17, 9},
                                         Case{1, {1, 1, 3}, 1, 17}, Case{1, {4, 7, 9}, 3, 1},
                                         Case{1, {1, 2, 70}, 9, 8}, Case{9, {1, 1, 1}, 1, 3},
                                         Case{9, {4, 33, 32}, 3, 3}, Case{9, {1, 66, 1030, false}, 9, 3},
                                         Case{9, {4, 9, 31, false}, 16, 17}, Case{9, {2, 5, 32, false}, 3, 3},
                                         Case{9, {1, 2, 1, false}, 3, 8}, Case{1, {4, 5, 13, false}, 17, 9}));

struct Layer {
    test::ImageBatch from, d_to;
    std::vector<double> weights, bias;
};

Layer make_random_layer(const Case& test_case) {
    return {test::make_random_images(test_case.grid, test_case.n_in, 1),
            test::make_random_images(test_case.grid, test_case.n_out, 2),
            test::make_random_floats(std::size_t(test_case.n_in) * test_case.n_out * test_case.taps, 3),
            test::make_random_floats(std::size_t(test_case.n_out), 4)};
}

TEST_P(ConvSizes, Forward) {
    const Case& c = GetParam();
    const Layer layer = make_random_layer(c);
    Convolution conv(device(), c.taps);
    Stream stream(device());
    const OnDevice from(device(), layer.from), to = OnDevice::make_unwritten(device(), c.grid, c.n_out),
                                               sum(device(), layer.d_to);
    const auto weights = test::to_device<shared::ConvWeights>(device(), layer.weights);
    const auto bias = test::to_device<shared::ConvBias>(device(), layer.bias);
    conv.run_convolution(stream, from.slice(), weights.address(), bias.address(), to.slice());
    conv.run_convolution(stream, from.slice(), weights.address(), {}, sum.slice(), true);
    stream.submit_and_wait();
    EXPECT_LT(compute_worst_error(to.read(), reference::convolve(layer.from, layer.weights, layer.bias,
                                                                 c.n_out, int(c.taps))),
              test::kLayer);
    test::ImageBatch added = reference::convolve(layer.from, layer.weights, {}, c.n_out, int(c.taps));
    for (std::size_t i = 0; i < added.values.size(); ++i) added.values[i] += layer.d_to.values[i];
    EXPECT_LT(compute_worst_error(sum.read(), added), test::kLayer);
}

TEST_P(ConvSizes, DerivativeByTheInput) {
    const Case& c = GetParam();
    const Layer layer = make_random_layer(c);
    Convolution conv(device(), c.taps);
    Stream stream(device());
    const OnDevice d_to(device(), layer.d_to), d_from = OnDevice::make_unwritten(device(), c.grid, c.n_in);
    const auto weights = test::to_device<shared::ConvWeights>(device(), layer.weights);
    conv.input_vjp(stream, d_to.slice(), weights.address(), d_from.slice());
    stream.submit_and_wait();
    EXPECT_LT(compute_worst_error(d_from.read(),
                                  reference::conv_input_vjp(layer.d_to, layer.weights, c.n_in, int(c.taps))),
              test::kLayer);
}

TEST_P(ConvSizes, DerivativeByTheWeights) {
    const Case& c = GetParam();
    const Layer layer = make_random_layer(c);
    Convolution conv(device(), c.taps);
    Stream stream(device());
    const OnDevice from(device(), layer.from), d_to(device(), layer.d_to);
    std::vector<double> guarded(layer.weights.size() + 1, std::nan(""));
    const auto d_weights = test::to_device<shared::ConvWeights>(device(), guarded),
               again = test::to_device<shared::ConvWeights>(device(), guarded);
    conv.reserve_weight_sums(device(),
                             conv.n_partial_sums(c.grid, std::uint32_t(c.n_in), std::uint32_t(c.n_out)));
    for (const auto* d : {&d_weights, &again}) {
        conv.weights_vjp(stream, from.slice(), d_to.slice(), d->address());
        stream.submit_and_wait();
    }
    std::vector<double> actual = test::to_doubles(d_weights), repeated = test::to_doubles(again);
    EXPECT_TRUE(std::isnan(actual.back())) << "wrote past the end";
    actual.pop_back();
    repeated.pop_back();
    EXPECT_LT(compute_worst_error(actual, reference::conv_weights_vjp(layer.from, layer.d_to, int(c.taps))),
              test::kLayer);
    EXPECT_EQ(actual, repeated);  // the order of summation is fixed
}

/// Specialisation of diff/network/conv: pixels per thread, and whether weights are stored
/// in shared memory.
struct Variant {
    std::uint32_t pixels, staged;
};
class ConvVariants : public test::DeviceTest, public testing::WithParamInterface<Variant> {};
INSTANTIATE_TEST_SUITE_P(Refine, ConvVariants, testing::Values(Variant{8, 1}, Variant{1, 1}, Variant{2, 0}));

/// Tests the variants that other devices use.
TEST_P(ConvVariants, Agree) {
    const auto lanes = std::uint32_t(device().info().subgroup_size);
    const auto tiles = [](std::uint32_t count, std::uint32_t size) { return (count + size - 1) / size; };
    for (const Case& c :
         {Case{9, {2, 5, 75}, 9, 17}, Case{9, {2, 5, 75, false}, 9, 17}, Case{1, {2, 3, 41}, 17, 9}}) {
        const Layer layer = make_random_layer(c);
        const Kernel<shared::ConvParams> kernel(device(), "diff/network/conv",
                                                {{SpecialisationConstantId::TAPS, c.taps},
                                                 {SpecialisationConstantId::PIXELS, GetParam().pixels},
                                                 {SpecialisationConstantId::LANES, lanes},
                                                 {SpecialisationConstantId::STAGED, GetParam().staged},
                                                 {SpecialisationConstantId::WORKGROUP_SIZE, 64}},
                                                SubgroupRequirement::full);
        Stream stream(device());
        const OnDevice from(device(), layer.from), to = OnDevice::make_unwritten(device(), c.grid, c.n_out);
        const auto weights = test::to_device<shared::ConvWeights>(device(), layer.weights);
        const auto bias = test::to_device<shared::ConvBias>(device(), layer.bias);
        const std::uint32_t segments =
            c.grid.n * c.grid.rows * tiles(c.grid.columns, lanes * GetParam().pixels);
        run(stream, kernel,
            std::size_t(tiles(segments, 64 / lanes)) * tiles(std::uint32_t(c.n_out), RELIDAR_CONV_OUT) * 64,
            {.from = from.slice().view,
             .to = to.slice().view,
             .weights = weights.address(),
             .bias = bias.address(),
             .n_images = c.grid.n,
             .rows = c.grid.rows,
             .columns = c.grid.columns,
             .n_in = std::uint32_t(c.n_in),
             .n_out = std::uint32_t(c.n_out),
             .transposed = 0,
             .accumulate = 0,
             .circular = c.grid.circular ? 1u : 0u});
        stream.submit_and_wait();
        EXPECT_LT(compute_worst_error(to.read(), reference::convolve(layer.from, layer.weights, layer.bias,
                                                                     c.n_out, int(c.taps))),
                  test::kLayer);
    }
}

}  // namespace
}  // namespace relidar
