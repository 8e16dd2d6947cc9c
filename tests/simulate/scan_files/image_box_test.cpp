// SPDX-License-Identifier: Apache-2.0
// Tests rectangles of boxes in a picture against numbers by hand.
#include <array>

#include <gtest/gtest.h>

#include "simulate/scan_files/layouts/layout.hpp"

namespace relidar {
namespace {

void expect_box(const std::optional<layouts::ImageBox>& box, const std::array<double, 4>& expected_px,
                double truncated) {
    ASSERT_TRUE(box);
    const std::array found_px{box->min_px.x, box->min_px.y, box->max_px.x, box->max_px.y};
    for (std::size_t i = 0; i < 4; ++i) EXPECT_NEAR(found_px[i], expected_px[i], 1e-3) << i;
    EXPECT_NEAR(box->truncated, truncated, 1e-9);
}

TEST(ImageBox, HasTheCornersOfTheBoxInFrontOfTheCamera) {
    const Camera camera{"camera", 100.0, 100.0, 100.0, 80.0, 201, 161};
    const auto project = [&](const glm::dvec3& centre_m, const glm::dvec3& size_m) {
        return layouts::project_box(camera, {glm::dquat(1, 0, 0, 0), centre_m}, size_m);
    };
    expect_box(project({0, 0, 5}, {2, 2, 2}), {75, 55, 125, 105}, 0.0);
    expect_box(project({-5, 1, 5}, {2, 2, 0}), {0, 80, 20, 120}, 0.5);      // symmetric to column 0
    expect_box(project({5, 4, 5}, {2, 2, 0}), {180, 140, 200, 160}, 0.75);  // in a corner
    // Beside the camera, from 2 m behind to 2 m before it. Only 1.9 m are in front of the
    // near plane at 0.1 m, where the box reaches to column 3100 and row 1580.
    const double share = 1.0 - 50.0 * 55.0 / (2950.0 * 1475.0);
    expect_box(project({2, 1, 0}, {2, 1, 4}), {150, 105, 200, 160}, share);
    EXPECT_FALSE(project({0, 0, -5}, {2, 2, 2})) << "behind the camera";
    EXPECT_FALSE(project({-8, 0, 5}, {2, 2, 2})) << "left of the picture";
}

}  // namespace
}  // namespace relidar
