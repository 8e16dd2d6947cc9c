// SPDX-License-Identifier: Apache-2.0
// Compares convolution (diff/network/conv, conv_weights and sum_parts), resampling (pool,
// pool_vjp, upsample and upsample_vjp) and attention (matmul and softmax) with the double
// reference. Covers odd sizes, equal pixels, the ring of columns, and slices.
#include "diff/network/layers.hpp"
#include "../../support/device.hpp"
#include "images.hpp"

namespace relidar {
namespace {

using network::Attention, network::AttentionState, network::Convolution, network::ImageBatchSize,
    network::Resampling;
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

TEST_P(ConvSizes, Derivatives) {
    const Case& c = GetParam();
    const Layer layer = make_random_layer(c);
    Convolution conv(device(), c.taps);
    Stream stream(device());
    const OnDevice from(device(), layer.from), d_to(device(), layer.d_to),
        d_from = OnDevice::make_unwritten(device(), c.grid, c.n_in);
    const auto weights = test::to_device<shared::ConvWeights>(device(), layer.weights);
    std::vector<double> guarded(layer.weights.size() + 1, std::nan(""));
    const auto d_weights = test::to_device<shared::ConvWeights>(device(), guarded),
               again = test::to_device<shared::ConvWeights>(device(), guarded);
    conv.reserve_weight_sums(device(), c.grid, std::uint32_t(c.n_in), std::uint32_t(c.n_out));
    conv.input_vjp(stream, d_to.slice(), weights.address(), d_from.slice());
    for (const auto* d : {&d_weights, &again}) {
        conv.weights_vjp(stream, from.slice(), d_to.slice(), d->address());
        stream.submit_and_wait();
    }
    EXPECT_LT(compute_worst_error(d_from.read(),
                                  reference::conv_input_vjp(layer.d_to, layer.weights, c.n_in, int(c.taps))),
              test::kLayer);
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
            c.grid.n * c.grid.rows * network::div_ceil(c.grid.columns, lanes * GetParam().pixels);
        run(stream, kernel,
            network::count_threads(segments, lanes) *
                network::div_ceil(std::uint32_t(c.n_out), RELIDAR_CONV_OUT),
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

struct UpsampleCase {
    ImageBatchSize small, large;
    int channels;
};
void PrintTo(const UpsampleCase& test_case, std::ostream* out) {
    *out << test_case.small.n << "x" << test_case.small.rows << "x" << test_case.small.columns << " -> "
         << test_case.large.rows << "x" << test_case.large.columns << ", " << test_case.channels;
}

class PoolSizes : public test::DeviceTest, public testing::WithParamInterface<test::ImageCase> {};
class UpsampleSizes : public test::DeviceTest, public testing::WithParamInterface<UpsampleCase> {};
INSTANTIATE_TEST_SUITE_P(Refine, PoolSizes,
                         testing::Values(test::ImageCase{{1, 66, 1030}, 3}, test::ImageCase{{4, 5, 13}, 9},
                                         test::ImageCase{{1, 7, 9}, 17}, test::ImageCase{{4, 2, 3}, 1},
                                         test::ImageCase{{1, 3, 2}, 3}, test::ImageCase{{4, 1, 3}, 3},
                                         test::ImageCase{{1, 5, 1}, 3}));
INSTANTIATE_TEST_SUITE_P(
    Refine, UpsampleSizes,
    testing::Values(UpsampleCase{{1, 33, 515}, {1, 66, 1030}, 3}, UpsampleCase{{4, 2, 6}, {4, 5, 13}, 9},
                    UpsampleCase{{1, 3, 4}, {1, 7, 9}, 17}, UpsampleCase{{4, 1, 1}, {4, 2, 3}, 1},
                    UpsampleCase{{1, 1, 2}, {1, 3, 5}, 3}, UpsampleCase{{1, 2, 3}, {1, 2, 3}, 3},
                    UpsampleCase{{4, 3, 2}, {4, 13, 9}, 3}, UpsampleCase{{1, 8, 16}, {1, 16, 32}, 3},
                    UpsampleCase{{1, 1, 1}, {1, 1, 1}, 1}, UpsampleCase{{1, 5, 7}, {1, 6, 8}, 3},
                    UpsampleCase{{1, 33, 515, false}, {1, 66, 1030, false}, 3},
                    UpsampleCase{{4, 3, 2, false}, {4, 13, 9, false}, 3},
                    UpsampleCase{{4, 1, 1, false}, {4, 2, 3, false}, 1}));

TEST_P(PoolSizes, PoolAndItsDerivative) {
    const test::ImageCase& c = GetParam();
    test::ImageBatch values = test::make_random_images(c.grid, c.channels, 1);
    // makes many values equal
    for (std::size_t i = 0; i < values.values.size(); i += 2) values.values[i] = std::round(values.values[i]);
    const ImageBatchSize small = network::half_size(c.grid);
    EXPECT_EQ(small, (ImageBatchSize{c.grid.n, c.grid.rows / 2, c.grid.columns / 2, c.grid.circular}));
    const test::ImageBatch upstream = test::make_random_images(small, c.channels, 2),
                           before = test::make_random_images(c.grid, c.channels, 3);
    Resampling resample(device());
    Stream stream(device());
    const OnDevice from(device(), values), to = OnDevice::make_unwritten(device(), small, c.channels),
                                           d_to(device(), upstream), d_from(device(), before);
    resample.max_pool(stream, from.slice(), to.slice());
    resample.max_pool_vjp(stream, from.slice(), d_to.slice(), d_from.slice());
    stream.submit_and_wait();
    EXPECT_EQ(to.read().values, reference::pool(values).values);
    test::ImageBatch expected = reference::backpropagate_pool(values, upstream);
    // max_pool_vjp adds to the existing gradient
    for (std::size_t i = 0; i < expected.values.size(); ++i) expected.values[i] += before.values[i];
    EXPECT_LT(compute_worst_error(d_from.read(), expected), 1e-6);
}

TEST_P(UpsampleSizes, UpsampleAndItsDerivative) {
    const UpsampleCase& c = GetParam();
    const test::ImageBatch values = test::make_random_images(c.small, c.channels, 1),
                           upstream = test::make_random_images(c.large, c.channels, 2);
    Resampling resample(device());
    Stream stream(device());
    const OnDevice from(device(), values), to = OnDevice::make_unwritten(device(), c.large, c.channels),
                                           d_to(device(), upstream),
                                           d_from = OnDevice::make_unwritten(device(), c.small, c.channels);
    resample.upsample(stream, from.slice(), to.slice());
    resample.upsample_vjp(stream, d_to.slice(), d_from.slice());
    stream.submit_and_wait();
    const test::ImageBatch actual = to.read(), back = d_from.read();
    EXPECT_LT(compute_worst_error(actual, reference::upsample(values, actual.rows, actual.columns)), 2e-6);
    EXPECT_LT(compute_worst_error(back, reference::upsample_vjp(upstream, back.rows, back.columns)), 2e-6);
}

struct AttentionCase {
    ImageBatchSize grid;
    int channels, heads;
};
void PrintTo(const AttentionCase& test_case, std::ostream* out) {
    *out << test_case.grid.n << "x" << test_case.grid.rows << "x" << test_case.grid.columns << ", "
         << test_case.channels << " in " << test_case.heads;
}

class AttentionTest : public test::DeviceTest {
protected:
    /// @param values queries, keys and values of one head
    test::ImageBatch attend(const test::ImageBatch& values) {
        const ImageBatchSize grid = test::get_grid(values);
        Attention attention(device(), 1);
        AttentionState state = attention.allocate_state(grid, false);
        Stream stream(device());
        const OnDevice qkv(device(), values),
            to = OnDevice::make_unwritten(device(), grid, values.channels / 3);
        attention.attend(stream, qkv.slice(), state, to.slice());
        stream.submit_and_wait();
        return to.read();
    }
};
class AttentionSizes : public test::DeviceTest, public testing::WithParamInterface<AttentionCase> {};
INSTANTIATE_TEST_SUITE_P(Refine, AttentionSizes,
                         testing::Values(AttentionCase{{1, 5, 13}, 8, 2}, AttentionCase{{4, 7, 9}, 18, 2},
                                         AttentionCase{{1, 1, 3}, 3, 3}, AttentionCase{{4, 1, 1}, 4, 1},
                                         AttentionCase{{2, 4, 32}, 64, 4}, AttentionCase{{4, 2, 5}, 17, 1},
                                         AttentionCase{{1, 9, 17}, 1, 1}));

TEST_P(AttentionSizes, ForwardAndBackward) {
    const AttentionCase& c = GetParam();
    const test::ImageBatch values = test::make_random_images(c.grid, 3 * c.channels, 1),
                           upstream = test::make_random_images(c.grid, c.channels, 2);
    Attention attention(device(), std::uint32_t(c.heads));
    AttentionState state = attention.allocate_state(c.grid, true);
    Stream stream(device());
    const OnDevice qkv(device(), values), to = OnDevice::make_unwritten(device(), c.grid, c.channels),
                                          d_to(device(), upstream),
                                          d_qkv = OnDevice::make_unwritten(device(), c.grid, 3 * c.channels);
    attention.attend(stream, qkv.slice(), state, to.slice());
    attention.attend_vjp(stream, qkv.slice(), state, d_to.slice(), d_qkv.slice());
    stream.submit_and_wait();
    EXPECT_LT(compute_worst_error(to.read(), reference::attend(values, c.heads)), test::kLayer);
    EXPECT_LT(compute_worst_error(d_qkv.read(), reference::attention_vjp(values, c.heads, upstream)),
              test::kLayer);
    const std::vector<double> shares = test::to_doubles(state.share.values);
    const std::size_t pixels = c.grid.n_image_pixels();
    ASSERT_EQ(shares.size(), c.grid.n * std::size_t(c.heads) * pixels * pixels);
    for (std::size_t row = 0; row < shares.size() / pixels; ++row) {
        double sum = 0.0;
        for (std::size_t k = 0; k < pixels; ++k) sum += shares[row * pixels + k];
        EXPECT_NEAR(sum, 1.0, 1e-5) << row;
    }
}

/// exp() of these scores overflows float.
TEST_F(AttentionTest, LargeScores) {
    const test::ImageBatch values = test::make_random_images({1, 3, 7}, 12, 1, 30.0);
    // scores of 1e3 have an error of 1e-4
    EXPECT_LT(compute_worst_error(attend(values), reference::attend(values, 1)), 1e-3);
}

/// The key of each pixel matches the query of its neighbour. Attention must therefore
/// shift the values by one pixel around the ring.
TEST_F(AttentionTest, TakesWhatItAsksFor) {
    const int n = 5;
    test::ImageBatch values(1, 3 * n, 1, n), expected(1, n, 1, n);
    for (int x = 0; x < n; ++x) {
        values.at(0, x, 0, x) = 100.0;               // the query of pixel x is x
        values.at(0, n + (x + 1) % n, 0, x) = 10.0;  // the key x belongs to the previous pixel
        values.at(0, 2 * n + x, 0, x) = 1.0;
        expected.at(0, (x + n - 1) % n, 0, x) = 1.0;
    }
    EXPECT_LT(compute_worst_error(attend(values), expected), 1e-6);
}

}  // namespace
}  // namespace relidar
