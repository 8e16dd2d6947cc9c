// SPDX-License-Identifier: Apache-2.0
// Checks the reference of densification against its goals: shared surfels blend to the
// opacity and the integral of the surfel that they replace, random numbers are normally
// distributed, and copies are distributed in proportion to the weights.
#include <cmath>
#include <numeric>

#include <gtest/gtest.h>

#include "densify.hpp"

namespace relidar::reference {
namespace {

/// Returns the integral over the plane of n blended equal surfels of scale s, in units of
/// 2 pi.
double blended(double opacity, double scale, int n) {
    constexpr int kSteps = 20000;
    const double end = 12.0 * scale, h = end / kSteps;
    double sum = 0.0;
    for (int i = 0; i < kSteps; ++i) {
        const double r = (i + 0.5) * h;
        sum += (1.0 - std::pow(1.0 - opacity * std::exp(-0.5 * r * r / (scale * scale)), n)) * r * h;
    }
    return sum;
}

TEST(Sharing, KeepsOpacityAndIntegral) {
    for (const double opacity : {0.02, 0.3, 0.9, 0.999})
        for (const int n : {1, 2, 3, 8, 15}) {
            const SharedSurfel s = share(opacity, n);
            EXPECT_NEAR(1.0 - std::pow(1.0 - s.opacity, n), opacity, 1e-12);
            EXPECT_NEAR(blended(s.opacity, s.scale_factor, n) / blended(opacity, 1.0, 1), 1.0, 1e-5)
                << opacity << " among " << n;
            EXPECT_LE(s.scale_factor, 1.0 + 1e-12);
        }
}

TEST(RandomNumbers, AreStandardNormal) {
    constexpr int kN = 200000;
    double sum[2]{}, square[2]{}, product = 0.0;
    for (std::uint32_t i = 0; i < kN; ++i) {
        const glm::dvec2 z = random_normal2(77, i, i % 3);
        for (int k = 0; k < 2; ++k) sum[k] += z[k], square[k] += z[k] * z[k];
        product += z.x * z.y;
    }
    const double sigma = 1.0 / std::sqrt(double(kN));
    for (int k = 0; k < 2; ++k) {
        EXPECT_NEAR(sum[k] / kN, 0.0, 4.0 * sigma);
        EXPECT_NEAR(square[k] / kN, 1.0, 4.0 * std::sqrt(2.0) * sigma);
    }
    EXPECT_NEAR(product / kN, 0.0, 4.0 * sigma);
}

TEST(Copies, AreExpectedNumbersRounded) {
    std::vector<std::uint32_t> weight;
    for (std::uint32_t i = 0; i < 500; ++i) weight.push_back(i % 7 == 0 ? 0 : (i * 37) % 256);
    const std::uint32_t total = std::accumulate(weight.begin(), weight.end(), 0u);
    for (const std::uint32_t n_new : {0u, 1u, 100u, 499u, 3000u}) {
        const std::vector<std::uint32_t> copies = copies_of(weight, n_new, total / 3);
        EXPECT_EQ(std::accumulate(copies.begin(), copies.end(), 0u), n_new);
        for (std::size_t i = 0; i < copies.size(); ++i)
            EXPECT_LT(std::abs(double(copies[i]) - double(weight[i]) * n_new / total), 1.0);
    }
}

}  // namespace
}  // namespace relidar::reference
