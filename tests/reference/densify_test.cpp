// SPDX-License-Identifier: Apache-2.0
// Tests the reference of densification: random numbers must be normally distributed, and
// copies must be distributed in proportion to the weights.
#include <cmath>
#include <numeric>

#include <gtest/gtest.h>

#include "densify.hpp"

namespace relidar::reference {
namespace {

TEST(RandomNumbers, AreStandardNormal) {
    constexpr int kN = 200000;
    double sum[2]{}, square[2]{}, product = 0.0;
    for (std::uint32_t i = 0; i < kN; ++i) {
        const glm::dvec2 z = normal_pair(77, i, i % 3);
        for (int k = 0; k < 2; ++k) {
            sum[k] += z[k];
            square[k] += z[k] * z[k];
        }
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
        const std::vector<std::uint32_t> copies = count_copies(weight, n_new, total / 3);
        EXPECT_EQ(std::accumulate(copies.begin(), copies.end(), 0u), n_new);
        for (std::size_t i = 0; i < copies.size(); ++i)
            EXPECT_LT(std::abs(double(copies[i]) - double(weight[i]) * n_new / total), 1.0);
    }
}

}  // namespace
}  // namespace relidar::reference
