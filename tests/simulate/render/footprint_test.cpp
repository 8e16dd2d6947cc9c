// SPDX-License-Identifier: Apache-2.0
// Tests beams with divergence. Checks the distribution of sub-rays, and compares the
// combination of sub-rays with results computed by hand. Also renders two walls with an
// edge inside a beam.
#include "simulate/render/footprint.hpp"

#include <cmath>

#include <gtest/gtest.h>

#include "base/random.hpp"

namespace relidar {
namespace {

RayTable make_one_ray(const glm::vec3& direction) {
    RayTable rays;
    rays.rows = rays.columns = 1;
    rays.origin = {{0.1f, 0.2f, 0.3f}};
    rays.direction = {glm::normalize(direction)};
    rays.time_offset_s = {0.05f};
    rays.channel = {7};
    return rays;
}

RayTable make_fan(int count) {
    RayTable rays;
    rays.rows = 1;
    rays.columns = count;
    for (int i = 0; i < count; ++i) {
        rays.origin.emplace_back(0.0f, 0.1f * float(i), 0.0f);
        rays.direction.push_back(glm::normalize(glm::vec3(1.0f, 0.3f * float(i), -0.2f * float(i))));
        rays.time_offset_s.push_back(0.01f * float(i));
        rays.channel.push_back(std::uint16_t(i));
        rays.ray_divergence_rad.push_back(1e-3f * float(i));
    }
    return rays;
}

/// Mean squared angle of sub-rays, relative to a uniform disc with a full angle of 1.
double spread(const RayTable& rays, const RayTable& parts, std::size_t index, std::size_t count) {
    double squares = 0.0;
    for (std::size_t k = 0; k < count; ++k) {
        const double chord =
            glm::distance(glm::dvec3(parts.direction[index * count + k]), glm::dvec3(rays.direction[index]));
        squares += std::pow(2.0 * std::asin(0.5 * chord), 2.0) / double(count);
    }
    return squares / 0.125;
}

TEST(Footprint, EachRayHasItsOwnCone) {
    const RayTable rays = make_fan(8);
    for (const std::size_t n : {std::size_t(5), std::size_t(9), std::size_t(40)}) {
        const RayTable per_ray_cones = split_rays(rays, int(n), 0.0), same = split_rays(rays, int(n), 4e-3);
        ASSERT_EQ(per_ray_cones.size(), 8 * n);
        for (std::size_t i = 0; i < 8; ++i) {
            EXPECT_NEAR(std::sqrt(spread(rays, per_ray_cones, i, n)), 1e-3 * double(i), 2e-6)
                << n << " parts of ray " << i;
            EXPECT_NEAR(std::sqrt(spread(rays, same, i, n)), 4e-3, 2e-6);
        }
    }
    EXPECT_FLOAT_EQ(float(rays.max_divergence_rad()), 7e-3f);
    EXPECT_EQ(make_one_ray({1, 0, 0}).max_divergence_rad(), 0.0);
}

TEST(Footprint, SomeRaysKeepTheirOwnCones) {
    const RayTable rays = make_fan(6), some = select_rays(rays, {4, 1, 5});
    EXPECT_EQ(some.columns, 3);
    const ScanArray<float>& all = rays.ray_divergence_rad;
    EXPECT_EQ(to_vector(some.ray_divergence_rad), (std::vector<float>{all[4], all[1], all[5]}));
    EXPECT_EQ(to_vector(some.channel), (std::vector<std::uint16_t>{4, 1, 5}));
    RayTable one = rays;
    one.ray_divergence_rad.clear();
    one.divergence_rad = 3e-3f;
    const RayTable few = select_rays(one, {4, 1});
    EXPECT_TRUE(few.ray_divergence_rad.empty());
    EXPECT_EQ(few.divergence_rad, 3e-3f);
}

TEST(Footprint, PartsAreSpreadAsAnEvenlyLitDisc) {
    const double divergence = 4e-3;
    for (const int n : {5, 9}) {
        for (const glm::vec3& direction :
             {glm::vec3(1, 0, 0), glm::vec3(0, 0, 1), glm::vec3(-0.3f, 0.5f, -0.7f)}) {
            const RayTable rays = make_one_ray(direction), parts = split_rays(rays, n, divergence);
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
            EXPECT_LT(glm::length(sum / double(n) - glm::dvec3(rays.direction[0])), 1e-5);
        }
    }
}

/// Range, intensity, drop probability, and distance of the mean range behind the range.
struct Part {
    float range_m, intensity, drop, spread_m = 0.0f;
};

RenderedScan scan_of(const std::vector<Part>& parts) {
    RenderedScan scan;
    for (const Part& part : parts) {
        scan.image.range_m.push_back(part.range_m);
        scan.median_range_m.push_back(part.range_m);
        scan.mean_range_m.push_back(part.range_m + part.spread_m);
        scan.image.intensity.push_back(part.intensity);
        scan.image.drop_prob.push_back(part.drop);
        scan.weight.push_back(1.0f);
        scan.instance.push_back(static_cast<std::int32_t>(scan.weight.size()) - 1);
    }
    return scan;
}

RenderedScan joined(const std::vector<Part>& parts, SensorConfig config = {},
                    const WeatherSensorProperties& sensor = {}, const IntensityResponse& response = {}) {
    config.sub_rays = static_cast<int>(parts.size());
    config.returns = 2;
    return join_sub_rays(scan_of(parts), make_one_ray({1, 0, 0}), config, response, sensor);
}

/// Mean of ranges, weighted by intensity / range^2.
double mean_by_power_m(const std::vector<Part>& parts) {
    double sum = 0.0, power = 0.0;
    for (const auto& [range_m, intensity, drop, spread_m] : parts) {
        sum += intensity / range_m;
        power += intensity / range_m / range_m;
    }
    return sum / power;
}

constexpr float kTolerance = 1e-6f;

TEST(Footprint, PartsOnOneSurfaceAreOneReturnOfTheirMeanWeighedByPower) {
    const std::vector<Part> parts{{10.0f, 0.2f, 0.1f},
                                  {10.1f, 0.2f, 0.1f},
                                  {10.2f, 0.4f, 0.1f},
                                  {10.3f, 0.1f, 0.1f},
                                  {10.4f, 0.1f, 0.1f}};
    const RenderedScan scan = joined(parts);
    EXPECT_NEAR(scan.image.range_m[0], mean_by_power_m(parts), 1e-5);
    EXPECT_NEAR(scan.image.intensity[0], 0.2f, kTolerance);
    EXPECT_NEAR(scan.image.drop_prob[0], 0.1f, kTolerance);
    EXPECT_EQ(scan.second_returns[0].range_m[0], 0.0f)
        << "steps below the separation are one surface, however far it reaches";
    EXPECT_EQ(scan.ring[0], 7);
}

TEST(Footprint, AnEdgeGivesTwoReturnsTheStrongestFirst) {
    const RenderedScan scan = joined({{30.0f, 0.3f, 0.0f, 0.5f},
                                      {10.0f, 0.04f, 0.0f, 4.0f},
                                      {30.0f, 0.3f, 0.0f, 0.25f},
                                      {10.0f, 0.04f, 0.0f, 4.0f},
                                      {30.0f, 0.3f, 0.0f, 0.0f}});
    EXPECT_NEAR(range_spread(scan)[0], 0.25f, 1e-5f) << "of the return's own parts";
    EXPECT_NEAR(scan.median_range_m[0], 30.0f, 1e-5f);
    EXPECT_NEAR(scan.image.intensity[0], 3 * 0.3f / 5, kTolerance);
    EXPECT_EQ(scan.instance[0], 0) << "of the part nearest to the middle";
    EXPECT_NEAR(scan.second_returns[0].range_m[0], 10.0f, 1e-5f)
        << "the strongest is the last: the next strongest is the second";
    EXPECT_NEAR(scan.second_returns[0].intensity[0], 2 * 0.04f / 5, kTolerance);
}

/// The power of a surface is share * reflectivity / range^2. The log's intensities are
/// brighter than that by the response.
TEST(Footprint, TheStrongestReturnHasTheLargestPower) {
    const IntensityResponse response{{1.0, 10.0, 80.0}, {0.5, 1.0, 0.125}, 0.0};
    const WeatherSensorProperties sensitive{.darkest = 0.0};
    Random random(11);
    int n_far = 0, n_unlike_light = 0;
    for (int beam = 0; beam < 300; ++beam) {
        const int n_near = 1 + int(random.sample_uniform() * 8.0);
        const double near_m = random.sample_uniform(2.0, 30.0),
                     far_m = near_m * random.sample_uniform(1.3, 4.0),
                     near_reflectivity = random.sample_uniform(0.01, 0.5),
                     far_reflectivity = random.sample_uniform(0.01, 0.5),
                     near_intensity = near_reflectivity * response.range_factor(near_m),
                     far_intensity = far_reflectivity * response.range_factor(far_m);
        std::vector<Part> parts;
        for (int k = 0; k < 9; ++k) {
            const bool is_near = k < n_near;
            parts.push_back(
                {float(is_near ? near_m : far_m), float(is_near ? near_intensity : far_intensity), 0.0f});
        }
        const double near_power = n_near * near_reflectivity / (near_m * near_m),
                     far_power = (9 - n_near) * far_reflectivity / (far_m * far_m);
        const bool is_far = far_power > near_power;
        const RenderedScan scan = joined(parts, {}, sensitive, response);
        EXPECT_NEAR(scan.median_range_m[0], is_far ? far_m : near_m, 1e-4) << beam;
        EXPECT_NEAR(scan.second_returns[0].range_m[0], is_far ? near_m : far_m, 1e-4) << beam;
        n_far += is_far;
        n_unlike_light += is_far != ((9 - n_near) * far_intensity > n_near * near_intensity);
    }
    EXPECT_GT(n_far, 20);
    EXPECT_GT(n_unlike_light, 40) << "the test distinguishes the two rules";
}

/// Parts without a gap of 0.5 m are one return. Its mean range, 10.7 m, is nearest to
/// part 2.
TEST(Footprint, AReturnHasTheInstanceOfTheSurfaceAtItsRange) {
    const std::vector<Part> parts{{10.0f, 0.3f, 0.0f},
                                  {10.4f, 0.3f, 0.0f},
                                  {10.85f, 0.3f, 0.0f},
                                  {11.25f, 0.3f, 0.0f},
                                  {11.5f, 0.3f, 0.0f}};
    const RenderedScan scan = joined(parts);
    EXPECT_NEAR(scan.median_range_m[0], mean_by_power_m(parts), 1e-4);
    EXPECT_EQ(scan.instance[0], 2);
}

TEST(Footprint, ASlopeIsOneReturnHoweverSteep) {
    const RayTable ray = make_one_ray({std::cos(0.04f), 0.0f, -std::sin(0.04f)}),
                   parts = split_rays(ray, 9, 4e-3);
    const auto cast = [&](float wall_m) {
        std::vector<Part> cone;
        for (const glm::vec3& d : parts.direction)
            cone.push_back({std::min(-1.8f / d.z, wall_m / d.x), 0.4f, 0.0f});
        return cone;
    };
    const auto [nearest, farthest] = std::ranges::minmax(cast(1e6f), {}, &Part::range_m);
    ASSERT_GT(farthest.range_m - nearest.range_m, 4.0f);
    const RenderedScan road = joined(cast(1e6f));
    EXPECT_NEAR(road.median_range_m[0], 1.8f / std::sin(0.04f), 0.3f);
    EXPECT_EQ(road.second_returns[0].range_m[0], 0.0f);
    SensorConfig fine;
    fine.return_separation_m = 0.2;
    EXPECT_GT(joined(cast(45.5f), fine).second_returns[0].range_m[0], 0.0f) << "road and wall are no plane";
}

TEST(Footprint, TheLastOfThreeIsTheSecondReturn) {
    const std::vector<Part> parts{{20.0f, 0.5f, 0.0f},
                                  {5.0f, 0.05f, 0.0f},
                                  {20.0f, 0.5f, 0.0f},
                                  {40.0f, 0.1f, 0.0f},
                                  {20.0f, 0.5f, 0.0f}};
    EXPECT_NEAR(joined(parts).median_range_m[0], 20.0f, 1e-5f);
    EXPECT_NEAR(joined(parts).second_returns[0].range_m[0], 40.0f, 1e-5f)
        << "the last, not the next strongest";
    // A fifth of the beam hits a surface of 0.1 at 40 m, which returns as much as a
    // surface of 0.02 that fills the beam.
    WeatherSensorProperties sensor;
    sensor.min_specified_power = 0.0201 / 1600.0;
    EXPECT_EQ(joined(parts, {}, sensor).second_returns[0].range_m[0], 5.0f) << "the last that is detected";
    sensor.min_specified_power = 0.0199 / 1600.0;
    EXPECT_EQ(joined(parts, {}, sensor).second_returns[0].range_m[0], 40.0f);
    SensorConfig coarse;
    coarse.return_separation_m = 16.0;
    EXPECT_NEAR(joined(parts, coarse).median_range_m[0],
                mean_by_power_m({parts[0], parts[1], parts[2], parts[4]}), 1e-4)
        << "one return where pulses overlap";
}

TEST(Footprint, PartsThatDropGiveNoLight) {
    const RenderedScan mostly = joined({{0.0f, 0.0f, 1.0f},
                                        {10.0f, 0.5f, 0.0f},
                                        {10.0f, 0.5f, 0.0f},
                                        {0.0f, 0.0f, 1.0f},
                                        {10.0f, 0.5f, 0.0f}});
    EXPECT_NEAR(mostly.image.drop_prob[0], 0.4f, kTolerance);
    EXPECT_NEAR(mostly.median_range_m[0], 10.0f, 1e-5f);
    EXPECT_NEAR(mostly.image.intensity[0], 0.3f, kTolerance);
    EXPECT_EQ(mostly.instance[0], 1);
    const RenderedScan hardly = joined({{0.0f, 0.0f, 1.0f},
                                        {10.0f, 0.5f, 0.0f},
                                        {30.0f, 0.5f, 0.0f},
                                        {0.0f, 0.0f, 1.0f},
                                        {0.0f, 0.0f, 1.0f}});
    EXPECT_NEAR(hardly.image.drop_prob[0], 0.6f, kTolerance);
    EXPECT_EQ(hardly.second_returns[0].range_m[0], 0.0f) << "a dropped ray has no second return";
    const RenderedScan nothing = joined({{12.0f, 0.3f, 0.9f},
                                         {0.0f, 0.0f, 1.0f},
                                         {0.0f, 0.0f, 1.0f},
                                         {0.0f, 0.0f, 1.0f},
                                         {0.0f, 0.0f, 1.0f}});
    EXPECT_NEAR(nothing.image.drop_prob[0], 0.98f, kTolerance);
    EXPECT_EQ(nothing.image.range_m[0], 12.0f) << "what the middle would have measured";
}

}  // namespace
}  // namespace relidar
