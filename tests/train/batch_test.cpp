// SPDX-License-Identifier: Apache-2.0
// Tests batches of rays, which the kernel train/gather_columns collects.
#include "train/frames/batch.hpp"

#include <set>

#include "../base/codecs/temporary_folder.hpp"
#include "../support/device.hpp"
#include "support/names.hpp"
#include "train/frames/frame_data.hpp"

namespace relidar {
namespace {

class Batch : public test::DeviceTest {};

/// Rays and targets contain their indices.
std::vector<TrainingFrameData> make_numbered_frame(Device& device, std::uint32_t rows, std::uint32_t columns,
                                                   bool image) {
    std::vector<DeviceRay> rays;
    std::vector<DeviceTarget> targets;
    for (std::uint32_t i = 0; i < rows * columns; ++i) {
        rays.push_back({glm::vec3(i, i / columns, i % columns), {1, 0, 0}, 0.0f});
        targets.push_back({float(i), 0.5f, 1.0f});
    }
    std::vector<TrainingFrameData> frames(1);
    frames[0].arrays =
        std::make_shared<FrameArrays>(FrameArrays{{device, std::span<const DeviceRay>(rays), "rays"},
                                                  {device, std::span<const DeviceTarget>(targets), "targets"},
                                                  {}});
    frames[0].n_rays = rows * columns;
    frames[0].n_returned = frames[0].n_known_rays = rows * columns;
    if (image) frames[0].image = {rows, columns, true};
    return frames;
}

Config make_config_for(const std::string& batch, int n_rays) {
    Config config;
    if (batch == "columns") config.loss.intensity_ssim = 0.15f;
    config.train.rays_per_iteration = n_rays;
    return config;
}

TEST_F(Batch, WindowsOfColumnsAreImages) {
    const std::vector<TrainingFrameData> frames = make_numbered_frame(device(), 4, 50, true);
    BatchSampler sampler(device(), make_config_for("columns", 45), frames);  // 11 columns
    Stream stream(device());
    Random random(3);
    std::set<int> firsts;
    for (int trial = 0; trial < 40; ++trial) {
        const SampledBatch batch = sampler.draw_batch(stream, frames[0], random);
        stream.submit_and_wait();
        ASSERT_EQ(batch.rays.n_rays, 44u);
        ASSERT_EQ(batch.targets.image.columns, 11u);
        EXPECT_EQ(batch.targets.image.rows, 4u);
        EXPECT_FALSE(batch.targets.image.circular);
        EXPECT_DOUBLE_EQ(batch.targets.n_returned, 44.0);
        const std::vector<DeviceRay> rays = batch.rays.rays->download();
        const std::vector<DeviceTarget> targets = batch.targets.targets->download();
        firsts.insert(int(rays[0].origin.z));
        for (std::size_t k = 0; k < 44; ++k) {
            EXPECT_EQ(rays[k].origin.y, float(k / 11));
            EXPECT_EQ(int(rays[k].origin.z), (int(rays[0].origin.z) + int(k % 11)) % 50);
            EXPECT_EQ(targets[k].range_m, rays[k].origin.x);
        }
    }
    EXPECT_GT(firsts.size(), 15u);
    EXPECT_GT(*firsts.rbegin(), 39) << "some windows wrap around";
}

TEST_F(Batch, GroupsOfColumnsAreAnImageAndNoColumnIsPreferred) {
    constexpr std::uint32_t kRows = 3, kColumns = 53, kStride = 5, kBatchColumns = kColumns / kStride;
    constexpr int kTrials = 2000;
    const std::vector<TrainingFrameData> frames = make_numbered_frame(device(), kRows, kColumns, true);
    BatchSampler sampler(device(), make_config_for("rays", 30), frames);  // every 5th column
    Stream stream(device());
    Random random(7);
    std::vector<int> drawn(kColumns, 0);
    for (int trial = 0; trial < kTrials; ++trial) {
        const SampledBatch batch = sampler.draw_batch(stream, frames[0], random);
        stream.submit_and_wait();
        ASSERT_EQ(batch.rays.n_rays, kRows * kBatchColumns);
        ASSERT_EQ(batch.rays.columns, kBatchColumns);
        ASSERT_EQ(batch.rays.stride, 1u);
        EXPECT_DOUBLE_EQ(batch.targets.n_returned, double(kRows * kBatchColumns));
        const std::vector<DeviceRay> rays = batch.rays.rays->download();
        const std::vector<DeviceTarget> targets = batch.targets.targets->download();
        for (std::uint32_t k = 0; k < kRows * kBatchColumns; ++k) {
            ASSERT_EQ(rays[k].origin.y, float(k / kBatchColumns));
            // the columns form groups of four neighbours, and the last group is shorter
            const std::uint32_t group = k % kBatchColumns / 4, within = k % kBatchColumns % 4;
            ASSERT_EQ(std::uint32_t(rays[k].origin.z),
                      (std::uint32_t(rays[0].origin.z) + group * 4 * kStride + within) % kColumns);
            ASSERT_EQ(targets[k].range_m, rays[k].origin.x);
            if (k < kBatchColumns) ++drawn[std::size_t(rays[k].origin.z)];
        }
    }
    const double expected = double(kTrials) * kBatchColumns / kColumns;  // 377, standard deviation about 17
    for (std::uint32_t c = 0; c < kColumns; ++c) EXPECT_NEAR(drawn[c], expected, 85.0) << "column " << c;
}

TEST_F(Batch, BatchesOfAFrameShareItsRaysOut) {
    for (const bool image : {true, false}) {
        const std::vector<TrainingFrameData> frames = make_numbered_frame(device(), 3, 60, image);
        BatchSampler sampler(device(), make_config_for("rays", 36), frames);  // every 5th ray
        Stream stream(device());
        std::vector<int> draw_counts(180, 0);
        for (std::uint32_t k = 0; k < 5; ++k) {
            const SampledBatch batch = sampler.gather(stream, frames[0], 3, k);
            stream.submit_and_wait();
            const std::vector<DeviceRay> rays = batch.rays.rays->download();
            for (std::uint32_t j = 0; j < batch.rays.n_rays; ++j) {
                const std::size_t ray = batch.frame_ray(j);
                ASSERT_LT(ray, draw_counts.size());
                ++draw_counts[ray];
                EXPECT_EQ(rays[batch.rays.first + j * batch.rays.stride].origin.x, float(ray));
            }
        }
        EXPECT_THAT(draw_counts, testing::Each(1)) << image;
    }
}

TEST_F(Batch, StridesBeyondTheColumnsTakeOne) {
    const std::vector<TrainingFrameData> frames = make_numbered_frame(device(), 8, 5, true);
    Stream stream(device());
    Random random(3);
    const SampledBatch one =
        BatchSampler(device(), make_config_for("rays", 3), frames).draw_batch(stream, frames[0], random);
    EXPECT_EQ(one.rays.n_rays, 8u);
    EXPECT_EQ(one.rays.columns, 1u);
}

TEST_F(Batch, EveryNthRayOfAListIsNoImageAndTheWholeFrameIs) {
    const std::vector<TrainingFrameData> frames = make_numbered_frame(device(), 4, 50, true),
                                         list = make_numbered_frame(device(), 4, 50, false);
    Stream stream(device());
    Random random(3);
    const SampledBatch some =
        BatchSampler(device(), make_config_for("rays", 40), list).draw_batch(stream, list[0], random);
    EXPECT_EQ(some.rays.stride, 5u);
    EXPECT_EQ(some.rays.n_rays, 40u);
    EXPECT_FALSE(some.targets.image.is_image());
    for (const char* batch : {"rays", "columns"}) {
        const SampledBatch all =
            BatchSampler(device(), make_config_for(batch, 0), frames).draw_batch(stream, frames[0], random);
        EXPECT_EQ(all.rays.n_rays, 200u);
        EXPECT_TRUE(all.targets.image.circular);
        EXPECT_EQ(all.targets.image.columns, 50u);
    }
}

TEST_F(Batch, RaysBringTheirTargets) {
    const std::vector<TrainingFrameData> image = make_numbered_frame(device(), 4, 50, true),
                                         cloud = make_numbered_frame(device(), 1, 50, false);
    for (const auto& [frames, way] : {std::pair(&image, "columns"), {&image, "rays"}, {&cloud, "rays"}}) {
        BatchSampler sampler(device(), make_config_for(way, 17), *frames);
        Stream stream(device());
        Random random(5);
        const SampledBatch batch = sampler.draw_batch(stream, frames->front(), random);
        stream.submit_and_wait();
        ASSERT_NE(batch.rays.targets, nullptr);
        EXPECT_EQ(batch.rays.targets, batch.targets.targets);
        EXPECT_EQ(batch.rays.first, batch.targets.first);
        EXPECT_EQ(batch.rays.stride, batch.targets.stride);
        const std::vector<DeviceRay> rays = batch.rays.rays->download();
        const std::vector<DeviceTarget> targets = batch.rays.targets->download();
        for (std::uint32_t k = 0; k < batch.rays.n_rays; ++k) {
            const std::uint32_t i = batch.rays.first + k * batch.rays.stride;
            EXPECT_EQ(rays[i].origin.x, targets[i].range_m) << way << " ray " << k;
        }
    }
}

TEST_F(Batch, SimilaritySeesWindows) {
    const std::vector<TrainingFrameData> image = make_numbered_frame(device(), 4, 50, true),
                                         cloud = make_numbered_frame(device(), 1, 50, false);
    Config config = make_config_for("rays", 40);
    config.loss.intensity_ssim = 0.15f;
    BatchSampler sampler(device(), config, image);
    Stream stream(device());
    Random random(3);
    const SampledBatch batch = sampler.draw_batch(stream, image[0], random);
    stream.submit_and_wait();
    EXPECT_EQ(batch.targets.image.columns, 10u);
    EXPECT_EQ(batch.window.stride, 1u);
    EXPECT_THAT(error_message<UsageError>([&] { BatchSampler(device(), config, cloud); }),
                test::Names("loss.intensity_ssim ... ordered"));
    config.loss.intensity_ssim = 0.0f;
    config.loss.likelihood = 0.15f;  // of single rays
    BatchSampler(device(), config, cloud);
}

}  // namespace
}  // namespace relidar
