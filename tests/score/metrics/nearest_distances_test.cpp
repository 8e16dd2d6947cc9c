// SPDX-License-Identifier: Apache-2.0
#include <relidar/score/metrics.hpp>

#include <algorithm>
#include <limits>
#include <random>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>

namespace relidar {
namespace {

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
    expect_exact(make_random_points(500, origin, wide, 1), make_random_points(700, origin, wide, 2));
    expect_exact(make_random_points(300, origin, wide, 3), make_random_points(1, origin, wide, 4));
    expect_exact(make_random_points(300, origin, wide, 5),
                 make_random_points(400, origin, {30.0, 0.0, 0.0}, 6));
    // coordinates of a map grid
    expect_exact(make_random_points(300, {4e5, 5e6, 100.0}, wide, 7),
                 make_random_points(400, {4e5, 5e6, 100.0}, wide, 8));
    expect_exact(make_random_points(300, origin, wide, 9), Points(1000, glm::dvec3(1.0, 2.0, 3.0)));
}

TEST(NearestDistances, AgreeOnManyThreads) {
    const Points query = make_random_points(20'000, glm::dvec3(0.0), glm::dvec3(10.0), 1);
    expect_exact(query, make_random_points(200, glm::dvec3(0.0), glm::dvec3(10.0), 2));
}

TEST(NearestDistances, AreZeroToThemselves) {
    const Points points = make_random_points(1000, glm::dvec3(0.0), glm::dvec3(10.0), 1);
    EXPECT_EQ(nearest_distances_m(points, points), std::vector<double>(1000, 0.0));
}

TEST(NearestDistances, OfNothingAreNone) {
    EXPECT_TRUE(nearest_distances_m({}, {}).empty());
    EXPECT_THROW(nearest_distances_m({glm::dvec3(0.0)}, {}), DataError);
}

TEST(NearestDistances, RefuseValuesThatAreNotFinite) {
    const Points good{glm::dvec3(0.0)}, bad{glm::dvec3(0.0, std::numeric_limits<double>::quiet_NaN(), 0.0)};
    EXPECT_THROW(nearest_distances_m(bad, good), DataError);
    EXPECT_THROW(nearest_distances_m(good, bad), DataError);
}

}  // namespace
}  // namespace relidar
