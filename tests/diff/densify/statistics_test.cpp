// SPDX-License-Identifier: Apache-2.0
// Compares the sums and counts of the kernel diff/densify/observe with sums in double.
// Also checks the normalisation of batches that contain only a part of a frame's rays.
#include <cmath>
#include <random>

#include <relidar/diff/densify.hpp>
#include <relidar/scene/device_scene.hpp>

#include "../../support/device.hpp"
#include "random_model.hpp"

namespace relidar {
namespace {

class Statistics : public test::DeviceTest {};

struct Observed {
    Device& device;
    DeviceScene scene;
    Densifier densifier;
    SurfelArrays gradients;
    Array<std::uint32_t, shared::TouchedSurfels> touched;
    Stream stream;
    std::uint32_t n;

    Observed(Device& d, std::uint32_t n_surfels, std::uint32_t n_frames)
        : Observed(d, test::make_random_model_scene({n_surfels}, 1), n_frames) {}
    Observed(Device& d, const Scene& initial, std::uint32_t n_frames)
        : device(d),
          scene(d, initial),
          densifier(d, initial, {.strategy = DensifyStrategy::adaptive}, 0.0f, n_frames, 1),
          gradients(d, scene.size(), "gradients"),
          touched(d, scene.size(), "touched"),
          stream(d),
          n(scene.size()) {}

    void show(const std::vector<float>& d_mean, const std::vector<std::uint32_t>& is_touched,
              std::uint32_t frame, bool is_full_frame) {
        gradients.mean.upload(d_mean);
        touched.upload(is_touched);
        densifier.record_statistics(stream, scene, {&gradients, &touched, frame, is_full_frame});
        stream.submit_and_wait();
    }
};

TEST_F(Statistics, SumsAndCountsOverBatches) {
    constexpr std::uint32_t kN = 333, kFrames = 70;  // three words of frame bits
    Observed o(device(), kN, kFrames);
    std::mt19937 random(5);
    std::normal_distribution<float> normal;
    std::vector<double> sum(kN, 0.0);
    std::vector<std::uint32_t> n_observing_batches(kN, 0);
    std::vector<std::vector<bool>> frames(kN, std::vector<bool>(kFrames, false));
    for (int batch = 0; batch < 24; ++batch) {
        const std::uint32_t frame = random() % kFrames;
        const bool full = batch % 2 == 0;
        std::vector<float> d_mean(3 * kN);
        std::vector<std::uint32_t> touched(kN);
        for (std::uint32_t i = 0; i < kN; ++i) {
            touched[i] = random() % 3 == 0;
            // undefined for surfels that are not touched
            for (std::uint32_t k = 0; k < 3; ++k) d_mean[3 * i + k] = touched[i] ? normal(random) : NAN;
            if (touched[i] || (!full && frames[i][frame])) ++n_observing_batches[i];
            if (!touched[i]) continue;
            sum[i] += std::sqrt(double(d_mean[3 * i]) * d_mean[3 * i] +
                                double(d_mean[3 * i + 1]) * d_mean[3 * i + 1] +
                                double(d_mean[3 * i + 2]) * d_mean[3 * i + 2]);
            frames[i][frame] = true;
        }
        o.show(d_mean, touched, frame, full);
    }
    const SurfelStatistics& s = o.densifier.statistics();
    ASSERT_EQ(s.n_words, 3u);
    const std::vector<float> sums = s.gradient_sum.download();
    const std::vector<std::uint32_t> counts = s.n_observing_batches.download(), bits = s.frames.download();
    for (std::uint32_t i = 0; i < kN; ++i) {
        EXPECT_NEAR(sums[i], sum[i], 1e-5 * (1.0 + sum[i]));
        EXPECT_EQ(counts[i], n_observing_batches[i]);
        for (std::uint32_t f = 0; f < kFrames; ++f)
            EXPECT_EQ((bits[3 * i + f / 32] >> (f % 32)) & 1u, frames[i][f] ? 1u : 0u);
    }
}

/// Surfel i covers i + 1 rays in each of three frames, all with the same gradient. The
/// loss is a mean over the batch. Batches with every s-th ray must give the same
/// statistics as batches with all rays. This also applies to surfels that most batches
/// miss.
TEST_F(Statistics, EveryStridethRayCountsAsTheWholeFrame) {
    constexpr std::uint32_t kN = 40, kRays = 1000, kStride = 16;
    const auto mean_of = [&](std::uint32_t stride, int n_batches) {
        Observed o(device(), kN, 3);
        std::mt19937 random(8);
        for (int batch = 0; batch < n_batches; ++batch) {
            const std::uint32_t first = random() % stride;
            std::vector<float> d_mean(3 * kN, 0.0f);
            std::vector<std::uint32_t> touched(kN, 0);
            for (std::uint32_t i = 0; i < kN; ++i)
                for (std::uint32_t ray = 7 * i; ray <= 8 * i; ++ray) {
                    if (ray % stride != first) continue;
                    touched[i] = 1;
                    d_mean[3 * i + 1] += float(stride) / kRays;
                }
            o.show(d_mean, touched, std::uint32_t(batch) % 3, stride == 1);
        }
        const std::vector<float> sum = o.densifier.statistics().gradient_sum.download();
        const std::vector<std::uint32_t> n_observing_batches =
            o.densifier.statistics().n_observing_batches.download();
        std::vector<double> mean(kN);
        for (std::uint32_t i = 0; i < kN; ++i) mean[i] = sum[i] / std::max(n_observing_batches[i], 1u);
        return mean;
    };
    const std::vector<double> full = mean_of(1, 3), part = mean_of(kStride, 600);
    for (std::uint32_t i = 0; i < kN; ++i) {
        EXPECT_NEAR(full[i], double(i + 1) / kRays, 1e-6);
        // checks the normalisation: a mean over only the batches that hit a surfel would
        // be 16 times too large for a single ray
        EXPECT_NEAR(part[i] / full[i], 1.0, 0.35) << i + 1 << " rays";
    }
}

}  // namespace
}  // namespace relidar
