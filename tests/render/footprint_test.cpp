// SPDX-License-Identifier: Apache-2.0
// Beams of finite divergence: how their parts are spread, what becomes of parts worked out by hand, and a scene of two walls whose edge a
// beam straddles.
#include "render/footprint.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include <relidar/math.hpp>

namespace relidar {
namespace {

RayTable one_ray(const glm::vec3& direction) {
    RayTable rays;
    rays.rows = rays.columns = 1;
    rays.origin = {{0.1f, 0.2f, 0.3f}};
    rays.direction = {glm::normalize(direction)};
    rays.time_offset_s = {0.05f};
    rays.channel = {7};
    return rays;
}

TEST(Footprint, PartsAreSpreadAsAnEvenlyLitDisc) {
    const double divergence = 4e-3;
    for (const int n : {5, 9}) {
        for (const glm::vec3& direction : {glm::vec3(1, 0, 0), glm::vec3(0, 0, 1), glm::vec3(-0.3f, 0.5f, -0.7f)}) {
            const RayTable rays = one_ray(direction), parts = split_rays(rays, n, divergence);
            ASSERT_EQ(parts.size(), std::size_t(n));
            EXPECT_EQ(parts.direction[0], rays.direction[0]);
            double squares = 0.0;
            glm::dvec3 sum(0.0);
            for (int i = 0; i < n; ++i) {
                const glm::dvec3 d(parts.direction[std::size_t(i)]);
                const double angle = glm::length(d - glm::dvec3(rays.direction[0]));
                EXPECT_LE(angle, 0.5 * divergence);
                squares += angle * angle;
                sum += d;
                EXPECT_EQ(parts.origin[std::size_t(i)], rays.origin[0]);
                EXPECT_EQ(parts.time_offset_s[std::size_t(i)], 0.05f);
                EXPECT_EQ(parts.channel[std::size_t(i)], 7);
            }
            EXPECT_NEAR(squares / n, 0.5 * (0.5 * divergence) * (0.5 * divergence), 1e-9) << n;
            EXPECT_LT(glm::length(sum / double(n) - glm::dvec3(rays.direction[0])), 1e-5) << "no part of the disc is preferred";
        }
    }
}

/// Parts of one footprint: range, intensity, drop probability.
struct Part {
    float range_m, intensity, drop;
};

RenderedScan scan_of(const std::vector<Part>& parts) {
    RenderedScan scan;
    for (const Part& part : parts) {
        scan.image.range_m.push_back(part.range_m);
        scan.median_range_m.push_back(part.range_m);
        scan.image.intensity.push_back(part.intensity);
        scan.image.drop_prob.push_back(part.drop);
        scan.weight.push_back(1.0f);
        scan.instance.push_back(static_cast<std::int32_t>(scan.weight.size()) - 1);
    }
    return scan;
}

RenderedScan joined(const std::vector<Part>& parts, SensorConfig config = {}) {
    config.sub_rays = static_cast<int>(parts.size());
    config.returns = 2;
    return join_footprints(scan_of(parts), one_ray({1, 0, 0}), config);
}

constexpr float kNear = 1e-6f;

TEST(Footprint, PartsOnOneSurfaceAreOneReturnOfTheirMeanWeighedByLight) {
    const RenderedScan scan =
        joined({{10.0f, 0.2f, 0.1f}, {10.1f, 0.2f, 0.1f}, {10.2f, 0.4f, 0.1f}, {10.3f, 0.1f, 0.1f}, {10.4f, 0.1f, 0.1f}});
    EXPECT_NEAR(scan.image.range_m[0], (10.0f * 0.2f + 10.1f * 0.2f + 10.2f * 0.4f + 10.3f * 0.1f + 10.4f * 0.1f), 1e-5f);
    EXPECT_NEAR(scan.image.intensity[0], 0.2f, kNear);
    EXPECT_NEAR(scan.image.drop_prob[0], 0.1f, kNear);
    EXPECT_EQ(scan.further[0].range_m[0], 0.0f) << "steps below the separation are one surface, however far it reaches";
    EXPECT_EQ(scan.channel[0], 7);
}

TEST(Footprint, AnEdgeGivesTwoReturnsTheStrongestFirst) {
    const RenderedScan scan =
        joined({{30.0f, 0.3f, 0.0f}, {10.0f, 0.2f, 0.0f}, {30.0f, 0.3f, 0.0f}, {10.0f, 0.2f, 0.0f}, {30.0f, 0.3f, 0.0f}});
    EXPECT_NEAR(scan.median_range_m[0], 30.0f, 1e-5f);
    EXPECT_NEAR(scan.image.intensity[0], 3 * 0.3f / 5, kNear);
    EXPECT_EQ(scan.instance[0], 0) << "of the part nearest to the middle";
    EXPECT_NEAR(scan.further[0].range_m[0], 10.0f, 1e-5f) << "the strongest is the last: the next strongest is the second";
    EXPECT_NEAR(scan.further[0].intensity[0], 2 * 0.2f / 5, kNear);
}

TEST(Footprint, TheLastOfThreeIsTheSecondReturn) {
    const std::vector<Part> parts{{20.0f, 0.5f, 0.0f}, {5.0f, 0.9f, 0.0f}, {20.0f, 0.5f, 0.0f}, {40.0f, 0.1f, 0.0f}, {20.0f, 0.5f, 0.0f}};
    EXPECT_NEAR(joined(parts).median_range_m[0], 20.0f, 1e-5f);
    EXPECT_EQ(joined(parts).further[0].range_m[0], 0.0f) << "0.1 is less than a tenth of 1.5";
    SensorConfig faint;
    faint.second_return_share = 0.05;
    EXPECT_NEAR(joined(parts, faint).further[0].range_m[0], 40.0f, 1e-5f) << "the last, not the next strongest";
    SensorConfig coarse;
    coarse.return_separation_m = 16.0;
    EXPECT_NEAR(joined(parts, coarse).median_range_m[0], (5 * 0.9f + 20 * 1.5f) / 2.4f, 1e-4f) << "one return where pulses overlap";
}

TEST(Footprint, PartsThatDropGiveNoLight) {
    const RenderedScan mostly =
        joined({{0.0f, 0.0f, 1.0f}, {10.0f, 0.5f, 0.0f}, {10.0f, 0.5f, 0.0f}, {0.0f, 0.0f, 1.0f}, {10.0f, 0.5f, 0.0f}});
    EXPECT_NEAR(mostly.image.drop_prob[0], 0.4f, kNear);
    EXPECT_NEAR(mostly.median_range_m[0], 10.0f, 1e-5f);
    EXPECT_NEAR(mostly.image.intensity[0], 0.3f, kNear);
    EXPECT_EQ(mostly.instance[0], 1);
    const RenderedScan hardly =
        joined({{0.0f, 0.0f, 1.0f}, {10.0f, 0.5f, 0.0f}, {30.0f, 0.5f, 0.0f}, {0.0f, 0.0f, 1.0f}, {0.0f, 0.0f, 1.0f}});
    EXPECT_NEAR(hardly.image.drop_prob[0], 0.6f, kNear);
    EXPECT_EQ(hardly.further[0].range_m[0], 0.0f) << "a dropped ray has no second return";
    const RenderedScan nothing =
        joined({{12.0f, 0.3f, 0.9f}, {0.0f, 0.0f, 1.0f}, {0.0f, 0.0f, 1.0f}, {0.0f, 0.0f, 1.0f}, {0.0f, 0.0f, 1.0f}});
    EXPECT_NEAR(nothing.image.drop_prob[0], 0.98f, kNear);
    EXPECT_EQ(nothing.image.range_m[0], 12.0f) << "what the middle would have measured";
}

}  // namespace
}  // namespace relidar
