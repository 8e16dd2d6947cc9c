// SPDX-License-Identifier: Apache-2.0
// Compares the inputs of the ray-drop network (diff/network/drop_inputs) with plain
// loops.
#include "../../support/device.hpp"
#include "diff/shared/refine.h"
#include "gpu/stream.hpp"
#include "images.hpp"

namespace relidar {
namespace {

class DropInputsTest : public test::DeviceTest {};

struct Batch {
    std::vector<double> images, start, target;
};

constexpr int kSamples = 3, kImages = 4, kChannels = 5, kLogit = 2;
const std::vector<std::uint32_t> kChosen{2, 0, 2, 1};

std::vector<double> scale() { return {1.0, 2.0, 0.5, -1.0, 4.0}; }
std::vector<double> shift() { return {0.0, 1.0, -3.0, 0.25, 2.0}; }

Batch turned(const test::ImageBatch& samples, const std::vector<double>& targets,
             const std::vector<std::uint32_t>& turn, int n_fixed) {
    const network::ImageBatchSize grid = test::get_grid(samples);
    test::ImageBatch images(kImages, kChannels, samples.rows, samples.columns),
        start(kImages, 1, samples.rows, samples.columns);
    test::ImageBatch target = start;
    for (int image = 0; image < kImages; ++image)
        for (int y = 0; y < samples.rows; ++y)
            for (int x = 0; x < samples.columns; ++x) {
                const auto sample = int(kChosen[std::size_t(image)]);
                const int to = int((std::uint64_t(x) + turn[std::size_t(image)]) % grid.columns);
                for (int c = 0; c < kChannels; ++c) {
                    const double affine =
                        scale()[std::size_t(c)] * samples.at(sample, c, y, x) + shift()[std::size_t(c)];
                    images.at(image, c, y, c < kChannels - n_fixed ? to : x) = affine;
                }
                start.at(image, 0, y, to) = samples.at(sample, kLogit, y, x);
                target.at(image, 0, y, to) =
                    targets[(std::size_t(sample) * grid.rows + std::size_t(y)) * grid.columns +
                            std::size_t(x)];
            }
    return {images.values, start.values, target.values};
}

TEST_F(DropInputsTest, TurnsWhatIsSeenAndKeepsTheSensorsOwn) {
    for (const network::ImageBatchSize& grid :
         {network::ImageBatchSize{kSamples, 5, 13}, network::ImageBatchSize{kSamples, 1, 3},
          network::ImageBatchSize{kSamples, 7, 70}})
        for (const int n_fixed : {0, 2}) {
            const std::vector<std::uint32_t> column_shifts{0, 1, grid.columns - 1, 2 * grid.columns + 2};
            const test::ImageBatch values = test::make_random_images(grid, kChannels, 1);
            const std::vector<double> target_values = test::make_random_floats(grid.n_pixels_total(), 2);
            const Batch expected = turned(values, target_values, column_shifts, n_fixed);
            const Kernel<shared::DropInputsParams> kernel(device(), "diff/network/drop_inputs");
            Stream stream(device());
            const auto samples = test::to_device<shared::DropSamples>(device(), values.values);
            const auto targets = test::to_device<shared::SampleTargets>(device(), target_values);
            const Array<std::uint32_t, shared::ChosenSamples> chosen(device(), kChosen, "chosen");
            const Array<std::uint32_t, shared::SampleTurns> turns(device(), column_shifts, "turn");
            const Array<glm::vec2> affine = test::upload_pairs(device(), scale(), shift());
            const std::size_t n = kImages * grid.n_image_pixels();
            const Array<float> images(device(), n * kChannels + 1, "images");
            const Array<float, shared::StartLogits> start(device(), n + 1, "start");
            const Array<float, shared::DropTargets> target(device(), n + 1, "target");
            const auto launch = [&](Address<float, shared::DropTargets> to_target) {
                run(stream, kernel, n,
                    {.samples = samples.address(),
                     .targets = targets.address(),
                     .chosen = chosen.address(),
                     .turn = turns.address(),
                     .scale_shift = affine.address(),
                     .images = images.address(),
                     .start = start.address(),
                     .target = to_target,
                     .n_images = kImages,
                     .n_channels = kChannels,
                     .n_fixed = std::uint32_t(n_fixed),
                     .logit_channel = kLogit,
                     .rows = grid.rows,
                     .columns = grid.columns});
                stream.submit_and_wait();
            };
            const auto written = [&](const Array<float>& array) {
                std::vector<double> result = test::to_doubles(array);
                EXPECT_TRUE(std::isnan(result.back())) << "wrote past the end";
                result.pop_back();
                return result;
            };
            for (const Buffer* array : {&images.buffer(), &start.buffer(), &target.buffer()})
                stream.fill(*array, 0x7fc00000u);
            launch({});  // without a target, no target is written
            for (const double x : test::to_doubles(target)) EXPECT_TRUE(std::isnan(x));
            EXPECT_LT(test::compute_worst_error(written(images), expected.images), 1e-6);
            launch(target.address());
            EXPECT_LT(test::compute_worst_error(written(images), expected.images), 1e-6);
            EXPECT_EQ(written(start), expected.start);
            EXPECT_EQ(written(target), expected.target);
        }
}

}  // namespace
}  // namespace relidar
