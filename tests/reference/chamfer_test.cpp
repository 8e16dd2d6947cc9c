// SPDX-License-Identifier: Apache-2.0
// Tests the reference's Chamfer distance against values computed by hand and central
// differences (Eq. 11).
#include <gtest/gtest.h>

#include <random>

#include "../support/gradient_check.hpp"
#include "chamfer.hpp"

namespace relidar::reference {
namespace {

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
            table.add_row(
                "range",
                test::compute_central_differences(
                    &rays[i].simulated_m, 1, [&] { return std::vector<double>{compute_chamfer_loss(rays)}; }),
                {d[i]});
    table.print("Chamfer");
    EXPECT_LE(table.compute_worst_error(), test::kReferenceGradient);
    EXPECT_EQ(table.groups().at("range").count_nonzero_rows(), 32u);
}

}  // namespace
}  // namespace relidar::reference
