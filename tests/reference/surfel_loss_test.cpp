// SPDX-License-Identifier: Apache-2.0
// Tests the loss terms of surfel parameters in the reference against values computed by
// hand and central differences.
#include <gtest/gtest.h>

#include <random>

#include "../support/gradient_check.hpp"
#include "surfel_loss.hpp"

namespace relidar::reference {
namespace {

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
        table.add_row("mean", test::compute_central_differences(s.mean.data(), 3, loss),
                      {d.mean[0], d.mean[1], d.mean[2]});
        table.add_row("log_scale", test::compute_central_differences(s.log_scale.data(), 2, loss),
                      {d.log_scale[0], d.log_scale[1]});
    }
    table.print("parameter terms");
    EXPECT_LE(table.compute_worst_error(), test::kReferenceGradient);
}

}  // namespace
}  // namespace relidar::reference
