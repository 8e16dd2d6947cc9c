// SPDX-License-Identifier: Apache-2.0
// Tests the visible share of a box's surface. Compares it with areas computed by hand.
#include <limits>
#include <random>

#include <relidar/scene/box_surface.hpp>

#include <gtest/gtest.h>

namespace relidar {
namespace {

// Each side has ten rows of patches, and the ground hides two of these rows.
const glm::dvec3 kSize_m(4.2, 2.4, 3.0);
constexpr double kSide_m2 = 4.2 * 2.4, kEnd_m2 = 2.4 * 2.4, kTop_m2 = 4.2 * 2.4,
                 kAll_m2 = 2 * kSide_m2 + 2 * kEnd_m2 + kTop_m2;

/// Marks all patches that the points of a plane make visible.
void add_plane(ObservedBoxSurface& surface, int axis, double at_m) {
    for (double a = -0.99; a < 1.0; a += 0.01)
        for (double b = -0.99; b < 1.0; b += 0.01) {
            const int first = (axis + 1) % 3, second = (axis + 2) % 3;
            glm::dvec3 point(0.0);
            point[axis] = at_m;
            point[first] = 0.5 * a * kSize_m[first];
            point[second] = 0.5 * b * kSize_m[second];
            surface.mark_observed(point, -point);
        }
}

TEST(BoxSurface, OfOneSideItsShareOfTheAreaIsSeen) {
    ObservedBoxSurface surface(kSize_m);
    add_plane(surface, 1, 1.2);
    EXPECT_DOUBLE_EQ(surface.observed_fraction(BoxSide::left), 1.0);
    for (const BoxSide side : {BoxSide::front, BoxSide::rear, BoxSide::right, BoxSide::top})
        EXPECT_EQ(surface.observed_fraction(side), 0.0);
    EXPECT_NEAR(surface.observed_fraction(), kSide_m2 / kAll_m2, 1e-12);
    EXPECT_NEAR(surface.mirrorable_fraction(), kSide_m2 / kAll_m2, 1e-12);
    add_plane(surface, 1, -1.2);
    EXPECT_NEAR(surface.observed_fraction(), 2.0 * kSide_m2 / kAll_m2, 1e-12);
    EXPECT_EQ(surface.mirrorable_fraction(), 0.0) << "nothing is left to complete";
    add_plane(surface, 0, -2.1);
    add_plane(surface, 2, 1.5);
    EXPECT_DOUBLE_EQ(surface.observed_fraction(BoxSide::rear), 1.0);
    EXPECT_DOUBLE_EQ(surface.observed_fraction(BoxSide::top), 1.0);
    EXPECT_NEAR(surface.observed_fraction(), 1.0 - kEnd_m2 / kAll_m2, 1e-12);
}

TEST(BoxSurface, HalfAnEndIsCompletedByItsOtherHalf) {
    ObservedBoxSurface surface(kSize_m);
    for (double y_m = 0.01; y_m < 1.2; y_m += 0.02)
        for (double z_m = -1.49; z_m < 1.5; z_m += 0.02) surface.mark_observed({2.1, y_m, z_m}, {-1, 0, 0});
    EXPECT_NEAR(surface.observed_fraction(BoxSide::front), 0.5, 1e-12);
    EXPECT_NEAR(surface.mirrorable_fraction(), 0.5 * kEnd_m2 / kAll_m2, 1e-12);
    EXPECT_TRUE(surface.is_mirror_observed({2.1, -0.5, 0.3}));
    EXPECT_FALSE(surface.is_mirror_observed({2.1, 0.5, 0.3})) << "it was seen itself";
    EXPECT_FALSE(surface.is_mirror_observed({-2.1, -0.5, 0.3})) << "the rear was not seen at all";
}

TEST(BoxSurface, DepthDoesNotMatterButDirectionDoes) {
    ObservedBoxSurface surface(kSize_m);
    surface.mark_observed({0.1, 0.4, 0.05}, {0, -1, 0});  // far inside
    EXPECT_TRUE(surface.is_observed({0.3, 1.2, 0.15}));
    EXPECT_FALSE(surface.is_observed({0.3, -1.2, 0.15}));
}

TEST(BoxSurface, ASideIsSeenFromOutside) {
    ObservedBoxSurface surface(kSize_m);
    // a ray through the window on the right to the inside of the door on the left
    surface.mark_observed({0.3, 1.1, 0.15}, {0.1, 0.9, 0.0});
    EXPECT_EQ(surface.observed_fraction(), 0.0);
    surface.mark_observed({0.3, 1.1, 0.15}, {0.99, -0.1, 0.0});  // a ray parallel to the side
    EXPECT_EQ(surface.observed_fraction(), 0.0);
    surface.mark_observed({0.3, 1.1, 0.15}, {0.8, -0.6, 0.0});
    EXPECT_TRUE(surface.is_observed({0.3, 1.1, 0.15}));
}

TEST(BoxSurface, WhatHasNoPlaceOnItMarksNothing) {
    constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
    ObservedBoxSurface surface(kSize_m);
    for (const glm::dvec3& point :
         {glm::dvec3(0.0), glm::dvec3(0.1, 0.1, -1.5), glm::dvec3(2.1, 0.0, -1.49), glm::dvec3(kNan)}) {
        surface.mark_observed(point, -point);
        EXPECT_FALSE(surface.is_observed(point));
    }
    EXPECT_EQ(surface.observed_fraction(), 0.0);
}

TEST(BoxSurface, EveryPatchHasItsMirrorImage) {
    std::mt19937 random(5);
    std::uniform_real_distribution<double> share(-0.5, 0.5);
    for (const glm::dvec3& size_m : {glm::dvec3(0.3, 0.2, 1.7), glm::dvec3(12.0, 2.55, 3.8), kSize_m}) {
        for (int i = 0; i < 1000; ++i) {
            const glm::dvec3 here = size_m * glm::dvec3(share(random), share(random), share(random)),
                             there(here.x, -here.y, here.z);
            ObservedBoxSurface surface(size_m);
            surface.mark_observed(here, -here);
            const bool counts = surface.is_observed(here);
            EXPECT_EQ(surface.is_mirror_observed(there), counts) << i;
            EXPECT_FALSE(surface.is_mirror_observed(here)) << i;
        }
    }
}

}  // namespace
}  // namespace relidar
