// SPDX-License-Identifier: Apache-2.0
// Compares diff/network/matmul and diff/network/softmax, used by attention, with the
// double reference: values, weights and derivatives.
#include "diff/network/attention.hpp"

#include "../../support/device.hpp"
#include "gpu/stream.hpp"
#include "images.hpp"

namespace relidar {
namespace {

using network::Attention, network::AttentionState, network::ImageBatchSize;
using test::OnDevice, test::compute_worst_error;

struct AttentionCase {
    ImageBatchSize grid;
    int channels, heads;
};
void PrintTo(const AttentionCase& test_case, std::ostream* out) {
    *out << test_case.grid.n << "x" << test_case.grid.rows << "x" << test_case.grid.columns << ", "
         << test_case.channels << " in " << test_case.heads;
}

class AttentionTest : public test::DeviceTest {};
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
    const ImageBatchSize grid{1, 3, 7};
    const test::ImageBatch values = test::make_random_images(grid, 12, 1, 30.0);
    Attention attention(device(), 1);
    AttentionState state = attention.allocate_state(grid, false);
    Stream stream(device());
    const OnDevice qkv(device(), values), to = OnDevice::make_unwritten(device(), grid, 4);
    attention.attend(stream, qkv.slice(), state, to.slice());
    stream.submit_and_wait();
    // scores of 1e3 have an error of 1e-4
    EXPECT_LT(compute_worst_error(to.read(), reference::attend(values, 1)), 1e-3);
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
    Attention attention(device(), 1);
    AttentionState state = attention.allocate_state(test::get_grid(values), false);
    Stream stream(device());
    const OnDevice qkv(device(), values), to = OnDevice::make_unwritten(device(), test::get_grid(values), n);
    attention.attend(stream, qkv.slice(), state, to.slice());
    stream.submit_and_wait();
    EXPECT_LT(compute_worst_error(to.read(), expected), 1e-6);
}

}  // namespace
}  // namespace relidar
