// SPDX-License-Identifier: Apache-2.0
#include <relidar/score/metrics.hpp>

#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

using Values = std::vector<double>;

double compute_reference_ssim(const Values& a, const Values& second, int rows, int columns,
                              double data_range) {
    const double c1 = 1e-4 * data_range * data_range, c2 = 9e-4 * data_range * data_range;
    double total = 0.0;
    int n_windows = 0;
    for (int row = 3; row < rows - 3; ++row)
        for (int column = 3; column < columns - 3; ++column, ++n_windows) {
            const int first = (row - 3) * columns + column - 3;
            const auto at = [&](const Values& values, int k) {
                return values[std::size_t(first + k / 7 * columns + k % 7)];
            };
            double ma = 0.0, mb = 0.0, va = 0.0, vb = 0.0, cov = 0.0;
            for (int k = 0; k < 49; ++k) {
                ma += at(a, k) / 49.0;
                mb += at(second, k) / 49.0;
            }
            for (int k = 0; k < 49; ++k) {
                const double da = at(a, k) - ma, db = at(second, k) - mb;
                va += da * da / 48.0;
                vb += db * db / 48.0;
                cov += da * db / 48.0;
            }
            total += (2 * ma * mb + c1) * (2 * cov + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2));
        }
    return total / n_windows;
}

Values make_random_values(int count, double scale, unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> unit(0.0, scale);
    Values values;
    for (int i = 0; i < count; ++i) values.push_back(unit(random));
    return values;
}

TEST(Ssim, AgreesWithTheDefinition) {
    for (const auto& [rows, columns] : {std::pair(7, 7), {7, 30}, {21, 8}, {66, 103}}) {
        const Values a = make_random_values(rows * columns, 80.0, 1);
        Values b = make_random_values(rows * columns, 20.0, 2);
        for (std::size_t i = 0; i < b.size(); ++i) b[i] += 0.7 * a[i];
        EXPECT_NEAR(compute_ssim(a, b, rows, columns, 80.0),
                    compute_reference_ssim(a, b, rows, columns, 80.0), 1e-12)
            << rows << " x " << columns;
    }
}

TEST(Ssim, IdenticalImagesScoreOne) {
    const Values a = make_random_values(20 * 30, 80.0, 3);
    EXPECT_NEAR(compute_ssim(a, a, 20, 30, 80.0), 1.0, 1e-14);
}

TEST(Ssim, ConstantImagesHaveAClosedForm) {
    const Values a(100, 2.0), b(100, 3.0);  // without variance, only the luminance term remains
    const double c1 = 1e-4 * 16.0;
    EXPECT_NEAR(compute_ssim(a, b, 10, 10, 4.0), (12.0 + c1) / (13.0 + c1), 1e-12);
}

TEST(Ssim, IsSymmetric) {
    const Values a = make_random_values(10 * 20, 1.0, 4), b = make_random_values(10 * 20, 1.0, 5);
    EXPECT_NEAR(compute_ssim(a, b, 10, 20, 1.0), compute_ssim(b, a, 10, 20, 1.0), 1e-14);
}

TEST(Ssim, RefusesWhatIsNotDefined) {
    const Values image(49, 1.0);
    EXPECT_THROW(compute_ssim(image, image, 7, 7, 0.0), DataError);
    EXPECT_THROW(compute_ssim(image, image, 7, 7, std::nan("")), DataError);
    EXPECT_THROW(compute_ssim(image, image, 7, 8, 1.0), DataError);
    EXPECT_THROW(compute_ssim(Values(48), Values(48), 6, 8, 1.0), DataError);
}

}  // namespace
}  // namespace relidar
