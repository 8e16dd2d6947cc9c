// SPDX-License-Identifier: Apache-2.0
// Tests the loss terms against values computed by hand, and their derivatives against
// central differences (docs/method.md section 5, M6).
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
            table.add_row("depth", test::compute_central_differences(&pixels[i].depth, 1, total),
                          {d[i].depth});
            table.add_row("weight", test::compute_central_differences(&pixels[i].weight, 1, total),
                          {d[i].weight});
            table.add_row("intensity", test::compute_central_differences(&pixels[i].intensity, 1, total),
                          {d[i].intensity});
            table.add_row("hit_logit", test::compute_central_differences(&pixels[i].hit_logit, 1, total),
                          {d[i].hit_logit});
            table.add_row("drop_logit", test::compute_central_differences(&pixels[i].drop_logit, 1, total),
                          {d[i].drop_logit});
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
        table.add_row("likelihood", test::compute_central_differences(&pixels[i].likelihood, 1, total),
                      {d[i].likelihood});
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

}  // namespace
}  // namespace relidar::reference
