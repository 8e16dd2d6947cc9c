// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/sensor.hpp>

#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

namespace relidar {
namespace {

TEST(RangeGrid, EveryPixelRayProjectsToItsOwnPixel) {
    const RangeImageGrid grid = kitti360_grid();
    const RayTable rays = make_rays(grid);
    ASSERT_EQ(rays.rows, 66);
    ASSERT_EQ(rays.columns, 1030);
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const auto pixel = project_to_pixel(grid, 17.0 * glm::dvec3(rays.direction[i]));
        ASSERT_TRUE(pixel) << i;
        ASSERT_EQ(*pixel, int(i));
    }
}

TEST(RangeGrid, BinsAreCentredOnTheRays) {
    const RangeImageGrid grid = kitti360_grid();
    const auto point = [](double row, double column) {
        const double el = (2.0 - row * 26.9 / 66) * kPi / 180,
                     az = (180.0 - column * 360.0 / 1030) * kPi / 180;
        return 10.0 * glm::dvec3(std::cos(el) * std::cos(az), std::cos(el) * std::sin(az), std::sin(el));
    };
    EXPECT_EQ(project_to_pixel(grid, point(3.49, 7.49)), 3 * 1030 + 7);
    EXPECT_EQ(project_to_pixel(grid, point(3.51, 7.51)), 4 * 1030 + 8);
    EXPECT_EQ(project_to_pixel(grid, point(0.0, 1029.6)), 0);  // the column wraps
    EXPECT_EQ(project_to_pixel(grid, point(-0.51, 5)), std::nullopt);
    EXPECT_EQ(project_to_pixel(grid, point(65.51, 5)), std::nullopt);
    EXPECT_EQ(project_to_pixel(grid, glm::dvec3(0.0)), std::nullopt);
    EXPECT_EQ(project_to_pixel(grid, 8.01 * point(3, 3)), std::nullopt);  // a range of 80.1 m
}

TEST(RangeGrid, NearestPointWinsAPixel) {
    const RangeImageGrid grid = kitti360_grid();
    const ProjectedRangeImage image =
        project_points(grid, {{20, 0, 0}, {10, 0, 0}, {15, 0, 0}, {0, 0, 5}}, {0.1f, 0.2f, 0.3f, 0.4f});
    const auto at = std::size_t(*project_to_pixel(grid, {10, 0, 0}));
    EXPECT_EQ(image.source[at], 1);
    EXPECT_FLOAT_EQ(image.range_m[at], 10.0f);
    EXPECT_FLOAT_EQ(image.intensity[at], 0.2f);
    EXPECT_EQ(std::count_if(image.source.begin(), image.source.end(), [](int s) { return s >= 0; }), 1);
    EXPECT_THROW(project_points(grid, {{1, 0, 0}}, {}), UsageError);
    EXPECT_THROW(find_grid("kiti360"), UsageError);
}

}  // namespace
}  // namespace relidar
