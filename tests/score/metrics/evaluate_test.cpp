// SPDX-License-Identifier: Apache-2.0
// Tests both metric protocols on small images whose metrics are computed by hand.
#include <relidar/log/range_image.hpp>
#include <relidar/score/metrics.hpp>

#include <cmath>
#include <limits>
#include <random>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

/// Rays start at (0, 0, 1) and point along x, y and z in turn.
RangeImage image_of(int rows, int columns, std::vector<float> range_m, std::vector<float> intensity,
                    std::vector<float> drop_prob) {
    RangeImage image{rows, columns, std::move(range_m), std::move(intensity), std::move(drop_prob), {}, {}};
    for (std::size_t i = 0; i < image.range_m.size(); ++i) {
        glm::vec3 direction(0.0f);
        direction[int(i % 3)] = 1.0f;
        image.origin.emplace_back(0.0f, 0.0f, 1.0f);
        image.direction.push_back(direction);
    }
    return image;
}

/// pixel        0                1                        2
/// real         10, returned     20, returned             dropped
/// rendered     10.02, returned  30, p = 0.45: between    5, p = 0.1: returned
///                               the two thresholds
const RangeImage kReal = image_of(1, 3, {10, 20, 0}, {0.5f, 0.25f, 0}, {0, 0, 1});
const RangeImage kRendered = image_of(1, 3, {10.02f, 30, 5}, {0.75f, 0.5f, 1}, {0, 0.45f, 0.1f});

constexpr double kClamp = 1e-6;

TEST(Evaluate, PeerImageErrorsByHand) {
    const MetricValues row = evaluate(kRendered, kReal);
    // pixel 1 counts as dropped: p >= 0.4
    const double e0 = double(10.02f) - 10.0, e1 = 20.0 - kClamp, e2 = 5.0 - kClamp;
    const double mse = (e0 * e0 + e1 * e1 + e2 * e2) / 3.0;
    EXPECT_NEAR(row.at("peer/depth_rmse_m"), std::sqrt(mse), 1e-12);
    EXPECT_NEAR(row.at("peer/depth_mae_m"), (e0 + e1 + e2) / 3.0, 1e-12);
    EXPECT_NEAR(row.at("peer/depth_medae_m"), e2, 1e-12);
    EXPECT_NEAR(row.at("peer/depth_psnr_db"), 10.0 * std::log10(6400.0 / mse), 1e-12);
    const double i0 = 0.25, i1 = 0.25 - kClamp, i2 = 1.0 - kClamp;
    const double intensity_mse = (i0 * i0 + i1 * i1 + i2 * i2) / 3.0;
    EXPECT_NEAR(row.at("peer/intensity_rmse"), std::sqrt(intensity_mse), 1e-12);
    EXPECT_NEAR(row.at("peer/intensity_mae"), (i0 + i1 + i2) / 3.0, 1e-12);
    EXPECT_NEAR(row.at("peer/intensity_medae"), 0.25, 1e-12);
    EXPECT_NEAR(row.at("peer/intensity_psnr_db"), -10.0 * std::log10(intensity_mse), 1e-12);
    EXPECT_FALSE(row.contains("peer/depth_ssim"));
}

TEST(Evaluate, PeerCloudByHand) {
    // Rendered points (10.02, 0, 1), (0, 0, 6); real points (10, 0, 1), (0, 20, 1).
    const MetricValues row = evaluate(kRendered, kReal);
    const double pair_distance_m = double(10.02f) - 10.0;
    const double to_real = (pair_distance_m * pair_distance_m + (100.0 + 25.0)) / 2.0;
    const double to_rendered = (pair_distance_m * pair_distance_m + (400.0 + 25.0)) / 2.0;
    EXPECT_NEAR(row.at("peer/cd_sq_m2"), to_real + to_rendered, 1e-9);
    EXPECT_NEAR(row.at("peer/f_score"), 0.5, 1e-12);  // precision and recall are 1/2
}

TEST(Evaluate, StrictByHand) {
    // Returned in both images: pixels 0 and 1. Rendered drops: no pixel. Real drops:
    // pixel 2.
    const MetricValues row = evaluate(kRendered, kReal);
    const double e0 = double(10.02f) - 10.0, e1 = 10.0;
    EXPECT_NEAR(row.at("strict/depth_rmse_m"), std::sqrt((e0 * e0 + e1 * e1) / 2.0), 1e-12);
    EXPECT_NEAR(row.at("strict/depth_mae_m"), (e0 + e1) / 2.0, 1e-12);
    EXPECT_NEAR(row.at("strict/depth_medae_m"), (e0 + e1) / 2.0, 1e-12);
    EXPECT_NEAR(row.at("strict/intensity_rmse"), 0.25, 1e-12);
    EXPECT_NEAR(row.at("strict/intensity_mae"), 0.25, 1e-12);
    EXPECT_NEAR(row.at("strict/intensity_medae"), 0.25, 1e-12);
    EXPECT_NEAR(row.at("strict/drop_accuracy"), 2.0 / 3.0, 1e-12);
    EXPECT_EQ(row.at("strict/drop_precision"), 0.0);
    EXPECT_EQ(row.at("strict/drop_recall"), 0.0);
    EXPECT_EQ(row.at("strict/drop_f1"), 0.0);
    // Rendered points (10.02,0,1), (0,30,1), (0,0,6); real points (10,0,1), (0,20,1).
    const double to_real = (e0 + 10.0 + std::sqrt(125.0)) / 3.0, to_rendered = (e0 + 10.0) / 2.0;
    EXPECT_NEAR(row.at("strict/cd_mean_m"), to_real + to_rendered, 1e-9);
    EXPECT_NEAR(row.at("strict/cd_sq_m2"), (e0 * e0 + 100.0 + 125.0) / 3.0 + (e0 * e0 + 100.0) / 2.0, 1e-9);
    const double precision = 1.0 / 3.0, recall = 0.5, f = 2.0 * precision * recall / (precision + recall);
    EXPECT_NEAR(row.at("strict/f_5cm"), f, 1e-12);
    EXPECT_NEAR(row.at("strict/f_22cm"), f, 1e-12);
}

TEST(Evaluate, PointsMayHaveOtherRangesThanTheImage) {
    RangeImage points = kRendered;
    points.range_m = kReal.range_m;
    const std::vector<PixelRegion> all{{"all", std::vector<bool>(kReal.range_m.size(), true)}};
    std::vector<MetricValues> rows =
        evaluate_all({{&kRendered, &kReal, all, points.range_m}, {&kRendered, &kReal, all}});
    EXPECT_EQ(rows[0].at("points/depth_rmse_m"), 0.0);
    EXPECT_EQ(rows[0].at("points/cd_mean_m"), evaluate_points(points, kReal).at("points/cd_mean_m"));
    EXPECT_EQ(rows[0].at("points/cd_mean_m"), evaluate(points, kReal).at("strict/cd_mean_m"));
    EXPECT_GT(rows[0].at("strict/depth_rmse_m"), 1.0) << "the image keeps its own";
    EXPECT_FALSE(rows[1].contains("points/depth_rmse_m"));
    EXPECT_EQ(rows[0].at("all/depth_rmse_m"), 0.0) << "regions score the points, too";
    EXPECT_GT(rows[1].at("all/depth_rmse_m"), 1.0);
}

TEST(Evaluate, ThresholdsOfTheFScore) {
    const RangeImage real = image_of(1, 2, {10, 10}, {0, 0}, {0, 0});
    // errors of 4 cm and 20 cm
    const RangeImage rendered = image_of(1, 2, {10.04f, 10.2f}, {0, 0}, {0, 0});
    const MetricValues row = evaluate(rendered, real);
    EXPECT_NEAR(row.at("strict/f_5cm"), 0.5, 1e-12);
    EXPECT_NEAR(row.at("strict/f_22cm"), 1.0, 1e-12);
    EXPECT_NEAR(row.at("peer/f_score"), 1.0, 1e-12);
}

TEST(Evaluate, DropsByHand) {
    const RangeImage real = image_of(1, 5, {1, 0, 0, 1, 0}, {0, 0, 0, 0, 0}, {0, 1, 1, 0, 1});
    const RangeImage rendered =
        image_of(1, 5, {1, 1, 1, 1, 0}, {0, 0, 0, 0, 0}, {0.2f, 0.9f, 0.3f, 0.5f, 0.1f});
    // rendered drops: 1, 3 (p = 0.5 is a drop), 4 (no range)
    const MetricValues row = evaluate(rendered, real);
    EXPECT_NEAR(row.at("strict/drop_accuracy"), 3.0 / 5.0, 1e-12);
    EXPECT_NEAR(row.at("strict/drop_precision"), 2.0 / 3.0, 1e-12);
    EXPECT_NEAR(row.at("strict/drop_recall"), 2.0 / 3.0, 1e-12);
    EXPECT_NEAR(row.at("strict/drop_f1"), 2.0 / 3.0, 1e-12);
    // Uses the differences between predicted and real drop: 0.2 - 0, 0.9 - 1, 0.3 - 1,
    // 0.5 - 0, 0.1 - 1. Pixels without a range are included.
    EXPECT_NEAR(row.at("strict/drop_rmse"), std::sqrt((0.04 + 0.01 + 0.49 + 0.25 + 0.81) / 5.0), 1e-7);
}

TEST(Evaluate, ClampsRanges) {
    const RangeImage real = image_of(1, 1, {100}, {3}, {0}), rendered = image_of(1, 1, {79}, {0.5f}, {0});
    const MetricValues row = evaluate(rendered, real);
    EXPECT_NEAR(row.at("peer/depth_rmse_m"), 1.0, 1e-12);
    EXPECT_NEAR(row.at("strict/depth_rmse_m"), 1.0, 1e-12);
    EXPECT_NEAR(row.at("peer/intensity_rmse"), 0.5, 1e-12);
    MetricOptions options;
    options.max_range_m = 120.0;
    EXPECT_NEAR(evaluate(rendered, real, options).at("peer/depth_rmse_m"), 21.0, 1e-12);
}

RangeImage make_random_image(int rows, int columns, unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> unit(0.0f, 1.0f);
    const std::size_t n = std::size_t(rows) * std::size_t(columns);
    std::vector<float> range(n), intensity(n), drop(n);
    for (std::size_t i = 0; i < n; ++i) {
        drop[i] = unit(random) < 0.2f ? 1.0f : 0.0f;
        range[i] = drop[i] > 0.5f ? 0.0f : 1.0f + 70.0f * unit(random);
        intensity[i] = unit(random);
    }
    RangeImage image = image_of(rows, columns, range, intensity, drop);
    for (glm::vec3& direction : image.direction)
        direction = glm::normalize(glm::vec3(unit(random), unit(random), unit(random)) - 0.5f);
    return image;
}

TEST(Evaluate, IdenticalImagesArePerfect) {
    const RangeImage image = make_random_image(16, 40, 7);
    const MetricValues row = evaluate(image, image);
    for (const char* name :
         {"peer/depth_rmse_m", "peer/depth_mae_m", "peer/depth_medae_m", "peer/intensity_rmse",
          "peer/cd_sq_m2", "strict/depth_rmse_m", "strict/intensity_rmse", "strict/cd_mean_m",
          "strict/cd_sq_m2", "strict/drop_rmse"})
        EXPECT_EQ(row.at(name), 0.0) << name;
    for (const char* name :
         {"peer/depth_ssim", "peer/intensity_ssim", "peer/f_score", "strict/f_5cm", "strict/f_22cm",
          "strict/drop_accuracy", "strict/drop_precision", "strict/drop_recall", "strict/drop_f1"})
        EXPECT_NEAR(row.at(name), 1.0, 1e-12) << name;
    EXPECT_NEAR(row.at("peer/depth_psnr_db"), 10.0 * std::log10(6400.0 / 1e-20), 1e-9);
    EXPECT_NEAR(row.at("peer/intensity_psnr_db"), 200.0, 1e-9);
    // The row has 12 metrics of the peer protocol and 25 metrics of the strict protocol.
    // It has no LPIPS, because the weights are missing.
    EXPECT_EQ(row.size(), 37u);
}

TEST(Evaluate, LeavesOutWhatIsNotDefined) {
    const std::vector<float> zero(1, 0.0f), one(1, 1.0f);
    const RangeImage dropped = image_of(1, 1, zero, zero, one), returned = image_of(1, 1, one, one, zero);
    const MetricValues nothing = evaluate(dropped, dropped);
    for (const char* name :
         {"strict/depth_rmse_m", "strict/cd_mean_m", "strict/f_5cm", "peer/cd_sq_m2", "peer/f_score"})
        EXPECT_FALSE(nothing.contains(name)) << name;
    EXPECT_EQ(nothing.at("strict/drop_f1"), 1.0);
    const MetricValues missed = evaluate(dropped, returned);
    EXPECT_FALSE(missed.contains("strict/cd_mean_m"));
    EXPECT_EQ(missed.at("strict/f_22cm"), 0.0);
    for (const auto& [name, value] : missed) EXPECT_TRUE(std::isfinite(value)) << name;
}

TEST(Evaluate, RefusesWrongShapesAndValues) {
    const RangeImage good = make_random_image(2, 3, 1);
    const auto refused = [&](auto change) {
        RangeImage bad = good;
        change(bad);
        EXPECT_THROW(evaluate(bad, good), DataError);
        EXPECT_THROW(evaluate(good, bad), DataError);
    };
    refused([](RangeImage& image) {
        image.rows = 3;
        image.columns = 2;
    });
    refused([](RangeImage& image) { image.rows = 0; });
    refused([](RangeImage& image) { image.range_m.pop_back(); });
    refused([](RangeImage& image) { image.intensity.push_back(0.0f); });
    refused([](RangeImage& image) { image.drop_prob.clear(); });
    refused([](RangeImage& image) { image.origin.pop_back(); });
    refused([](RangeImage& image) { image.direction.pop_back(); });
    refused([](RangeImage& image) { image.range_m[2] = std::numeric_limits<float>::quiet_NaN(); });
    refused([](RangeImage& image) { image.intensity[2] = std::numeric_limits<float>::infinity(); });
    refused([](RangeImage& image) { image.drop_prob[5] = std::numeric_limits<float>::quiet_NaN(); });
}

TEST(Mean, IsOverTheFramesThatHaveTheMetric) {
    const MetricValues result = mean_metrics({{{"a", 1.0}, {"b", 5.0}}, {{"a", 3.0}}});
    EXPECT_EQ(result, (MetricValues{{"a", 2.0}, {"b", 5.0}}));
    EXPECT_TRUE(mean_metrics({}).empty());
}

TEST(ClassScores, AreTheShareOfEqualClassesAndTheMeanIou) {
    using enum SurfaceClass;
    const std::vector<SurfaceClass> real = {road, road, road, pole, unknown, building};
    const MetricValues scores = score_classes({5, 5, 12, 12, 5, -1}, real);
    EXPECT_DOUBLE_EQ(scores.at("classes/accuracy"), 3.0 / 5.0);
    EXPECT_DOUBLE_EQ(scores.at("classes/mean_iou"), (2.0 / 3.0 + 1.0 / 2.0 + 0.0) / 3.0);
    EXPECT_TRUE(score_classes({5, -1}, std::vector{unknown, unknown}).empty());
}

}  // namespace
}  // namespace relidar
