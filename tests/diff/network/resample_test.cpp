// SPDX-License-Identifier: Apache-2.0
// Compares diff/network/pool, pool_vjp, upsample and upsample_vjp with the double
// reference. Covers odd sizes, equal pixels, the ring of columns, and slices.
#include "diff/network/resample.hpp"

#include "../../support/device.hpp"
#include "gpu/stream.hpp"
#include "images.hpp"

namespace relidar {
namespace {

using network::ImageBatchSize, network::Resampling;
using test::OnDevice, test::compute_worst_error;

struct PoolCase {
    ImageBatchSize grid;
    int channels;
};
void PrintTo(const PoolCase& test_case, std::ostream* out) {
    *out << test_case.grid.n << "x" << test_case.grid.rows << "x" << test_case.grid.columns << ", "
         << test_case.channels;
}

struct UpsampleCase {
    ImageBatchSize small, large;
    int channels;
};
void PrintTo(const UpsampleCase& test_case, std::ostream* out) {
    *out << test_case.small.n << "x" << test_case.small.rows << "x" << test_case.small.columns << " -> "
         << test_case.large.rows << "x" << test_case.large.columns << ", " << test_case.channels;
}

class PoolSizes : public test::DeviceTest, public testing::WithParamInterface<PoolCase> {};
class UpsampleSizes : public test::DeviceTest, public testing::WithParamInterface<UpsampleCase> {};
INSTANTIATE_TEST_SUITE_P(Refine, PoolSizes,
                         testing::Values(PoolCase{{1, 66, 1030}, 3}, PoolCase{{4, 5, 13}, 9},
                                         PoolCase{{1, 7, 9}, 17}, PoolCase{{4, 2, 3}, 1},
                                         PoolCase{{1, 3, 2}, 3}, PoolCase{{4, 1, 3}, 3},
                                         PoolCase{{1, 5, 1}, 3}));
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
    const PoolCase& c = GetParam();
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

}  // namespace
}  // namespace relidar
