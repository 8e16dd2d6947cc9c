// SPDX-License-Identifier: Apache-2.0
// Tests the loss terms against values computed by hand (the structural similarity against
// scipy), and their derivatives against central differences (docs/method.md section 5).
#include <gtest/gtest.h>

#include <random>

#include "../support/gradient_check.hpp"
#include "loss.hpp"

namespace relidar::reference {
namespace {

Pixel pixel(double depth, double weight, double intensity, double hit, double drop) {
    Pixel p;
    p.depth = depth;
    p.weight = weight;
    p.intensity = intensity;
    p.hit_logit = hit;
    p.drop_logit = drop;
    return p;
}

TEST(ReferenceLoss, HandComputed) {
    const std::vector<Pixel> pixels{pixel(9, 0.9, 0.4, 1, 1), pixel(5, 0.5, 0.2, 0, 0),
                                    pixel(3, 1.0, 0.7, -1, 2)};
    const std::vector<Target> targets{{10.5, 0.5}, {8, 0.1}, {0, 0}};
    const LossTerms blended = evaluate_loss(pixels, targets, {}, DepthKind::blended);
    EXPECT_NEAR(blended.depth, (1.5 + 3.0) / 2, 1e-12);
    EXPECT_NEAR(blended.intensity, (0.1 + 0.1) / 2, 1e-12);
    EXPECT_NEAR(blended.drop, (2 * std::log(2.0) - std::log(1 / (1 + std::exp(-3.0)))) / 3, 1e-12);
    EXPECT_NEAR(blended.total, 0.1 * blended.depth + 0.1 * blended.intensity + 0.01 * blended.drop, 1e-12);
    EXPECT_NEAR(evaluate_loss(pixels, targets, {}, DepthKind::normalised).depth, (0.5 + 2.0) / 2, 1e-12);
}

TEST(ReferenceLoss, DerivativesAgreeWithDifferences) {
    std::mt19937_64 random(11);
    std::uniform_real_distribution<double> uniform(0.1, 1.0);
    std::vector<Pixel> pixels;
    std::vector<Target> targets;
    for (int i = 0; i < 20; ++i) {
        pixels.push_back(pixel(10 * uniform(random), uniform(random), uniform(random),
                               4 * uniform(random) - 2, 4 * uniform(random) - 2));
        targets.push_back({i % 3 == 0 ? 0.0 : 10 * uniform(random), uniform(random)});
    }
    for (const DepthKind kind : {DepthKind::blended, DepthKind::normalised}) {
        const LossWeights weights{0.7, 1.3, 0.9, kind == DepthKind::blended ? 0.0 : 0.3};
        std::vector<PixelGradient> d;
        evaluate_loss(pixels, targets, weights, kind, &d);
        test::GradientTable table;
        const auto total = [&] {
            return std::vector<double>{evaluate_loss(pixels, targets, weights, kind).total};
        };
        for (std::size_t i = 0; i < pixels.size(); ++i) {
            add_differences(table, "depth", &pixels[i].depth, &d[i].depth, 1, total);
            add_differences(table, "weight", &pixels[i].weight, &d[i].weight, 1, total);
            add_differences(table, "intensity", &pixels[i].intensity, &d[i].intensity, 1, total);
            add_differences(table, "hit_logit", &pixels[i].hit_logit, &d[i].hit_logit, 1, total);
            add_differences(table, "drop_logit", &pixels[i].drop_logit, &d[i].drop_logit, 1, total);
        }
        table.print(kind == DepthKind::blended ? "loss on D" : "loss on D / W");
        EXPECT_LE(table.compute_worst_error(), test::kReferenceGradient);
    }
}

TEST(ReferenceLoss, HuberIsSquaredUpToDelta) {
    const auto of = [](double error) {
        return evaluate_loss({pixel(1, 1, 0.5 + error, 0, 0)}, {{1, 0.5}}, {0, 1, 0, 0.2}, DepthKind::blended)
            .intensity;
    };
    EXPECT_NEAR(of(0.1), 0.025, 1e-15);
    EXPECT_NEAR(of(-0.2), 0.1, 1e-15) << "where both parts meet";
    EXPECT_NEAR(of(0.3), 0.2, 1e-15);
}

TEST(ReferenceLoss, Likelihood) {
    std::vector<Pixel> pixels(4);
    pixels[0].likelihood = 1.0;
    pixels[1].likelihood = 0.25;
    pixels[2].likelihood = 0.0;
    pixels[3].likelihood = 0.5;
    const std::vector<Target> targets{{17, 0}, {2.5, 0}, {3, 0}, {0, 0}};
    EXPECT_NEAR(compute_likelihood_loss(pixels, targets, 0.01),
                -(std::log(0.01 + 0.99 * 0.25) + std::log(0.01)) / 3, 1e-12)
        << "0 where the hits explain all of it, bounded where nothing does, nothing of a dropped ray";
    std::vector<PixelGradient> d;
    compute_likelihood_loss(pixels, targets, 0.01, &d);
    test::GradientTable table;
    const auto total = [&] { return std::vector<double>{compute_likelihood_loss(pixels, targets, 0.01)}; };
    for (std::size_t i = 0; i < pixels.size(); ++i)
        add_differences(table, "likelihood", &pixels[i].likelihood, &d[i].likelihood, 1, total);
    EXPECT_LE(table.compute_worst_error(), test::kReferenceGradient);
}

TEST(ReferenceLoss, ExtremeAndDegenerateInputsStayFinite) {
    const std::vector<Pixel> pixels{pixel(0, 0, 0, 1e4, -1e4), pixel(0, 0, 0, -1e4, 1e4),
                                    pixel(5, 1, 0, 0, 0)};
    const std::vector<Target> targets{{0, 0}, {4, 0.2}, {5, 0}};
    std::vector<PixelGradient> d;
    const LossTerms terms = evaluate_loss(pixels, targets, {1, 1, 1}, DepthKind::normalised, &d);
    EXPECT_NEAR(terms.drop, (2e4 + 2e4 + std::log(2.0)) / 3, 1e-6);
    EXPECT_EQ(d[1].depth, 0.0) << "W = 0: no normalised depth";
    EXPECT_EQ(d[2].depth, 0.0) << "|x| at 0";
    for (const PixelGradient& g : d)
        EXPECT_TRUE(std::isfinite(g.depth + g.weight + g.intensity + g.hit_logit + g.drop_logit));
    std::vector<PixelGradient> none;
    const LossTerms nothing_returned =
        evaluate_loss({pixel(1, 1, 1, 0, 0)}, {{0, 0}}, {}, DepthKind::blended, &none);
    EXPECT_EQ(nothing_returned.depth, 0.0);
    EXPECT_EQ(none[0].depth, 0.0);
}

TEST(ReferenceChamfer, HandComputed) {
    const glm::dvec3 x(1, 0, 0), y(0, 1, 0);
    std::vector<double> d;
    EXPECT_NEAR(compute_chamfer_loss({{{}, x, 11.0, 10.0}, {{0, 0, 5}, y, 0.0, 7.0}}, &d),
                1.0 + 1.0 + (121.0 + 49.0 + 25.0), 1e-12);
    EXPECT_NEAR(d[0], 2.0 + 2.0 + 2.0 * 11.0, 1e-12)
        << "as query, found by its own pixel, and found by the other";
    EXPECT_EQ(d[1], 0.0);
    EXPECT_EQ(compute_chamfer_loss({{{}, x, 11.0, 0.0}}, &d), 0.0) << "nothing measured";
    EXPECT_EQ(compute_chamfer_loss({{{}, x, 0.0, 3.0}}, &d), 0.0) << "nothing simulated";
}

TEST(ReferenceChamfer, DerivativesAgreeWithDifferences) {
    std::mt19937_64 random(4);
    std::uniform_real_distribution<double> uniform(-1.0, 1.0);
    std::vector<ChamferRay> rays;
    for (int i = 0; i < 40; ++i) {
        ChamferRay ray{{0.1 * uniform(random), 0.0, 0.0},
                       glm::normalize(glm::dvec3(1.0, uniform(random), 0.3 * uniform(random))),
                       5.0 + uniform(random),
                       5.0 + uniform(random)};
        if (i % 5 == 0) ray.simulated_m = 0.0;
        if (i % 7 == 0) ray.measured_m = 0.0;
        rays.push_back(ray);
    }
    std::vector<double> d;
    compute_chamfer_loss(rays, &d);
    test::GradientTable table;
    for (std::size_t i = 0; i < rays.size(); ++i)
        if (rays[i].simulated_m > 0.0)
            add_differences(table, "range", &rays[i].simulated_m, &d[i], 1,
                            [&] { return std::vector<double>{compute_chamfer_loss(rays)}; });
    table.print("Chamfer");
    EXPECT_LE(table.compute_worst_error(), test::kReferenceGradient);
    EXPECT_EQ(table.groups().at("range").count_nonzero_rows(), 32u);
}

Image make_waves(bool circular) {
    Image image{12, 15, circular, {}, {}, {}};
    for (int i = 0; i < 12; ++i)
        for (int j = 0; j < 15; ++j) {
            image.x.push_back(0.5 + 0.4 * std::sin(0.7 * i + 0.3 * j * j / 4));
            image.y.push_back(0.5 + 0.4 * std::sin(0.6 * i + 0.3 * j * j / 4 + 0.5));
            image.is_known.push_back((3 * i + 5 * j) % 7 != 0);
        }
    return image;
}

/// Compares with scipy. The expected values are the mean of 1 - S over pixels with a
/// known value, with scipy.ndimage.correlate1d over columns ("wrap" or "constant") and
/// rows ("constant"). The moments are divided by the mask after the same filter.
TEST(ReferenceSsim, AgreesWithScipy) {
    EXPECT_NEAR(compute_ssim_loss(make_waves(true)), 0.0632199605965267, 1e-12);
    EXPECT_NEAR(compute_ssim_loss(make_waves(false)), 0.06353378196252815, 1e-12);
}

TEST(ReferenceSsim, KnownCases) {
    Image image = make_waves(true);
    image.x = image.y;
    EXPECT_NEAR(compute_ssim_loss(image), 0.0, 1e-12) << "equal images";
    image.is_known.assign(image.is_known.size(), false);
    EXPECT_EQ(compute_ssim_loss(image), 0.0) << "nothing known";
    image.is_known[20] = true;
    image.x[20] = 0.2;
    image.y[20] = 0.6;
    EXPECT_NEAR(compute_ssim_loss(image), 1.0 - (2 * 0.12 + 1e-4) / (0.04 + 0.36 + 1e-4), 1e-12)
        << "one pixel: its luminance alone";
}

TEST(ReferenceSsim, DerivativesAgreeWithDifferences) {
    for (const bool circular : {true, false}) {
        Image image = make_waves(circular);
        std::vector<double> d;
        compute_ssim_loss(image, &d);
        test::GradientTable table;
        for (std::size_t i = 0; i < image.x.size(); ++i)
            add_differences(table, "x", &image.x[i], &d[i], 1,
                            [&] { return std::vector<double>{compute_ssim_loss(image)}; });
        table.print("structural similarity");
        EXPECT_LE(table.compute_worst_error(), test::kReferenceGradient);
        EXPECT_EQ(table.groups().at("x").count_missing_rows(), 0u);
    }
}

const Box kCar{{2.0, 1.0, 0.75}, 0.5};

TEST(ReferenceSurfelLoss, HandComputed) {
    BoxedSurfel d;
    EXPECT_EQ(compute_box_loss({{1.9, -0.9, 0.7}, {std::log(0.4), std::log(0.1)}}, kCar, 1.0, d), 0.0)
        << "inside";
    EXPECT_NEAR(compute_box_loss({{3.0, -1.5, 0.0}, {std::log(1.0), std::log(0.1)}}, kCar, 1.0, d),
                0.5 + 0.5 + 1.0, 1e-12);
    EXPECT_NEAR(d.mean[0], 0.5, 1e-12);
    EXPECT_NEAR(d.mean[1], -1.0, 1e-12);
}

TEST(ReferenceSurfelLoss, DerivativesAgreeWithDifferences) {
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> uniform(-3.0, 3.0);
    test::GradientTable table;
    for (int i = 0; i < 50; ++i) {
        BoxedSurfel s{{uniform(random), uniform(random), uniform(random)},
                      {uniform(random), uniform(random)}},
            d, unused;
        compute_box_loss(s, kCar, 1.0, d);
        const auto loss = [&] { return std::vector<double>{compute_box_loss(s, kCar, 1.0, unused)}; };
        add_differences(table, "mean", s.mean.data(), d.mean.data(), 3, loss);
        add_differences(table, "log_scale", s.log_scale.data(), d.log_scale.data(), 2, loss);
    }
    table.print("parameter terms");
    EXPECT_LE(table.compute_worst_error(), test::kReferenceGradient);
}

}  // namespace
}  // namespace relidar::reference
