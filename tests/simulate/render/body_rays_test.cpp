// SPDX-License-Identifier: Apache-2.0
// Tests rays that hit the own vehicle, against the distance to a box that this test
// computes with other means: the nearest of the six sides whose point is on the box.
#include "simulate/render/body_rays.hpp"

#include <gtest/gtest.h>

#include <relidar/log/classes.hpp>
#include "../plates.hpp"
#include "base/random.hpp"

namespace relidar {
namespace {

constexpr double kSlack_m = 1e-9;

/// Distance along a ray to the first point on the surface of a box. The ray starts
/// outside.
std::optional<double> distance_to_sides(const VehicleBox& box, const glm::dvec3& origin_m,
                                        const glm::dvec3& direction) {
    std::optional<double> nearest_m;
    for (int k = 0; k < 3; ++k)
        for (const double sign : {-1.0, 1.0}) {
            const glm::dvec3 normal =
                box.frame_from_box.rotation *
                glm::dvec3(k == 0 ? sign : 0.0, k == 1 ? sign : 0.0, k == 2 ? sign : 0.0);
            const glm::dvec3 on_side_m = box.frame_from_box.translation + 0.5 * box.size_m[k] * normal;
            const double t = glm::dot(on_side_m - origin_m, normal) / glm::dot(direction, normal);
            const glm::dvec3 p = glm::abs(inverse(box.frame_from_box) * (origin_m + t * direction));
            if (t > 0.0 && glm::all(glm::lessThan(p, 0.5 * box.size_m + kSlack_m)) &&
                (!nearest_m || t < *nearest_m))
                nearest_m = t;
        }
    return nearest_m;
}

TEST(OwnVehicle, RayMeetsTheNearestSideOfItsBoxes) {
    Random random(7);
    const auto any = [&](double most) { return random.sample_uniform(-most, most); };
    int n_hits = 0;
    for (int i = 0; i < 20000; ++i) {
        std::vector<VehicleBox> boxes;
        for (int b = 0; b < 2; ++b)
            boxes.push_back({{make_rotation(any(3), any(1), any(1)), {any(3), any(3), any(3)}},
                             {1.0 + any(0.8), 2.0 + any(1.5), 1.0 + any(0.5)}});
        const glm::dvec3 origin_m = 8.0 * glm::normalize(glm::dvec3(any(1), any(1), any(1) + 1e-3));
        const glm::dvec3 direction = glm::normalize(glm::dvec3(any(3), any(3), any(3)) - origin_m);
        std::optional<double> expected;
        for (const VehicleBox& box : boxes)
            if (const auto t = distance_to_sides(box, origin_m, direction);
                t && (!expected || *t < *expected))
                expected = t;
        const std::optional<BodyHit> hit = find_body_hit(boxes, origin_m, direction);
        ASSERT_EQ(hit.has_value(), expected.has_value()) << i;
        if (!hit) continue;
        ++n_hits;
        EXPECT_NEAR(hit->range_m, *expected, 1e-9);
        EXPECT_LT(glm::dot(hit->normal, direction), 0.0);
        EXPECT_FALSE(find_body_hit(boxes, origin_m, -direction)) << "the boxes are ahead of the sensor";
    }
    EXPECT_GT(n_hits, 2000);
    const std::vector<VehicleBox> around{{{}, {4.0, 2.0, 2.0}}};
    EXPECT_FALSE(find_body_hit(around, {0.5, 0.0, 0.0}, {1, 0, 0})) << "a sensor inside the outline";
    // parallel to four sides: from 3 m to the front at 2 m, and past the box
    EXPECT_EQ(find_body_hit(around, {5.0, 0.5, 0.0}, {-1, 0, 0})->range_m, 3.0);
    EXPECT_FALSE(find_body_hit(around, {5.0, 1.5, 0.0}, {-1, 0, 0}));
}

/// Four rays of a roof sensor, with a bonnet whose top is 1 m below: a ray that meets it,
/// a ray above it, a ray to a near object, and a ray that the scene has dropped.
RenderedScan make_scan(const glm::vec3& down) {
    RenderedScan scan;
    scan.image.direction = {down, {1.0f, 0.0f, 0.0f}, down, down};
    scan.image.range_m = {9.0f, 30.0f, 0.8f, 0.0f};
    scan.image.drop_prob = {0.2f, 0.1f, 0.0f, 1.0f};
    scan.weight = {1.0f, 1.0f, 1.0f, 0.0f};
    scan.channels = {{parse_channels("class").front(), std::vector<std::int32_t>{5, 9, 3, -1}},
                     {parse_channels("incidence").front(), std::vector<float>(4, 0.5f)}};
    return test::complete(std::move(scan));
}

TEST(OwnVehicle, PointsOnItAreKeptOrDropped) {
    const glm::vec3 down(0.8f, 0.0f, -0.6f);  // meets the bonnet after 1 m / 0.6
    const VehicleBody drop{{{{{1, 0, 0, 0}, {2.0, 0.0, -1.5}}, {4.0, 2.0, 1.0}}}, false};
    VehicleBody keep = drop;
    keep.keeps_points = true;
    for (const VehicleBody& body : {drop, keep}) {
        RenderedScan scan = make_scan(down);
        block_rays(scan, body, {0.5, 80.0});
        scan.median_range_m[0] += 0.03f;  // noise
        block_rays(scan, body, {0.5, 80.0});
        for (const std::size_t hit : {0, 3}) {
            EXPECT_NEAR(scan.median_range_m[hit], 1.0 / 0.6, 1e-6);
            EXPECT_EQ(scan.image.range_m[hit], scan.median_range_m[hit]);
            EXPECT_EQ(scan.image.drop_prob[hit], body.keeps_points ? 0.0f : 1.0f);
            EXPECT_EQ(scan.instance[hit], kOwnVehicleInstance);
            EXPECT_EQ((*find_values<std::int32_t>(scan.channels, "class"))[hit], int(SurfaceClass::ego));
            EXPECT_NEAR((*find_values<float>(scan.channels, "incidence"))[hit], 0.6f, 1e-6f);
        }
        const RenderedScan before = make_scan(down);
        for (const std::size_t other : {1, 2}) {
            EXPECT_EQ(scan.median_range_m[other], before.median_range_m[other]);
            EXPECT_EQ(scan.image.drop_prob[other], before.image.drop_prob[other]);
            EXPECT_EQ(scan.instance[other], 0);
        }
    }
    RenderedScan near = make_scan(down);
    block_rays(near, keep, {2.0, 80.0});
    EXPECT_EQ(near.image.drop_prob[0], 1.0f) << "nearer than the sensor can measure";
}

}  // namespace
}  // namespace relidar
