// SPDX-License-Identifier: Apache-2.0
// Compares structural similarity and nearest distances with their definitions.
#include <relidar/score/metrics.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
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

TEST(Ssim, HasClosedForms) {
    const Values one = make_random_values(20 * 30, 80.0, 3), other = make_random_values(20 * 30, 80.0, 4);
    EXPECT_NEAR(compute_ssim(one, one, 20, 30, 80.0), 1.0, 1e-14);
    EXPECT_NEAR(compute_ssim(one, other, 20, 30, 80.0), compute_ssim(other, one, 20, 30, 80.0), 1e-14);
    const Values a(100, 2.0), b(100, 3.0);  // without variance, only the luminance term remains
    const double c1 = 1e-4 * 16.0;
    EXPECT_NEAR(compute_ssim(a, b, 10, 10, 4.0), (12.0 + c1) / (13.0 + c1), 1e-12);
}

TEST(Ssim, RefusesWhatIsNotDefined) {
    const Values image(49, 1.0);
    EXPECT_THROW(compute_ssim(image, image, 7, 7, 0.0), DataError);
    EXPECT_THROW(compute_ssim(image, image, 7, 7, std::nan("")), DataError);
    EXPECT_THROW(compute_ssim(image, image, 7, 8, 1.0), DataError);
    EXPECT_THROW(compute_ssim(Values(48), Values(48), 6, 8, 1.0), DataError);
}

using Points = std::vector<glm::dvec3>;

std::vector<double> brute_force(const Points& query, const Points& target) {
    std::vector<double> distance(query.size(), std::numeric_limits<double>::infinity());
    for (std::size_t i = 0; i < query.size(); ++i)
        for (const glm::dvec3& point : target)
            distance[i] = std::min(distance[i], glm::distance(query[i], point));
    return distance;
}

Points make_random_points(int count, glm::dvec3 centre, glm::dvec3 extent, unsigned seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    Points points;
    for (int i = 0; i < count; ++i)
        points.push_back(centre + extent * glm::dvec3(normal(random), normal(random), normal(random)));
    return points;
}

void expect_exact(const Points& query, const Points& target) {
    const std::vector<double> actual = nearest_distances_m(query, target),
                              expected = brute_force(query, target);
    ASSERT_EQ(actual.size(), expected.size());
    for (std::size_t i = 0; i < actual.size(); ++i)
        ASSERT_NEAR(actual[i], expected[i], 1e-12 * (1.0 + expected[i])) << i;
}

TEST(NearestDistances, AgreeWithBruteForce) {
    const glm::dvec3 origin(0.0), wide(30.0, 30.0, 2.0);
    const auto cloud = [&](int count, unsigned seed) {
        return make_random_points(count, origin, wide, seed);
    };
    expect_exact(cloud(500, 1), cloud(700, 2));
    expect_exact(cloud(300, 3), cloud(1, 4));
    expect_exact(cloud(300, 5), make_random_points(400, origin, {30.0, 0.0, 0.0}, 6));
    // coordinates of a map grid
    expect_exact(make_random_points(300, {4e5, 5e6, 100.0}, wide, 7),
                 make_random_points(400, {4e5, 5e6, 100.0}, wide, 8));
    expect_exact(cloud(300, 9), Points(1000, glm::dvec3(1.0, 2.0, 3.0)));
    expect_exact(cloud(20'000, 10), cloud(200, 11));  // several threads
    EXPECT_EQ(nearest_distances_m(cloud(1000, 1), cloud(1000, 1)), std::vector<double>(1000, 0.0));
}

TEST(NearestDistances, NeedFiniteTargets) {
    EXPECT_TRUE(nearest_distances_m({}, {}).empty());
    const Points good{glm::dvec3(0.0)}, bad{glm::dvec3(0.0, std::numeric_limits<double>::quiet_NaN(), 0.0)};
    EXPECT_THROW(nearest_distances_m(good, {}), DataError);
    EXPECT_THROW(nearest_distances_m(bad, good), DataError);
    EXPECT_THROW(nearest_distances_m(good, bad), DataError);
}

}  // namespace

}  // namespace relidar
