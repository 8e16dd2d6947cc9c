// SPDX-License-Identifier: Apache-2.0
// Tests weather effects on complete scans: stray light against its integral, the sun in
// front of and behind a wall, and the mirror of wet ground.

#include <gtest/gtest.h>

#include "../../support/device.hpp"
#include "../plates.hpp"
#include "simulate/weather/air.hpp"

namespace relidar {
namespace {

constexpr double kDegree = kPi / 180.0;
constexpr int kBeams = 128, kSteps = 192;
constexpr double kStep_deg = 0.25, kRadius_deg = 2.5;

/// Rays are at intervals of 0.25 degrees.
/// @param reflectors {azimuth_deg, elevation_deg, range_m}
RenderedScan make_wall_with(const std::vector<glm::dvec3>& reflectors) {
    RenderedScan scan;
    scan.image.rows = kBeams;
    scan.image.columns = kSteps;
    for (int row = 0; row < kBeams; ++row) {
        for (int column = 0; column < kSteps; ++column) {
            const double azimuth = kDegree * kStep_deg * (column - kSteps / 2 + 0.5);
            const double elevation = kDegree * kStep_deg * (kBeams / 2 - row - 0.5);
            const glm::dvec3 d(std::cos(elevation) * std::cos(azimuth),
                               std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
            const auto has_ray = [&](const glm::dvec3& r) {
                return std::hypot(azimuth - r.x * kDegree, elevation - r.y * kDegree) < kRadius_deg * kDegree;
            };
            const auto met = std::ranges::find_if(reflectors, has_ray);
            scan.image.direction.push_back(glm::vec3(d));
            scan.image.range_m.push_back(met == reflectors.end() ? 20.0f : float(met->z));
            scan.image.intensity.push_back(met == reflectors.end() ? 0.2f : 1.0f);
            scan.ring.push_back(std::uint16_t(row));
        }
    }
    return test::complete(std::move(scan));
}
std::size_t ray_at(int row, int column) { return std::size_t(row) * kSteps + std::size_t(column); }

/// The sensor detects any power. Empty if no ray has stray light.
std::vector<LidarEcho> compute_stray_light(const RenderedScan& scan, double bloom, std::uint64_t seed) {
    const WeatherSensorProperties sensor{.darkest = 0.0};
    const auto effect = kBloomingEffect.prepare(
        {.weather = {.bloom = bloom}, .sensor = sensor, .scan = scan, .response = {}, .seed = seed});
    std::vector<LidarEcho> stray(effect ? scan.ring.size() : 0);
    Random random(0);
    for (std::size_t i = 0; i < stray.size(); ++i) {
        EchoCandidates candidates;
        effect->append_returns(candidates, {.index = i, .free_m = 1.0}, random);
        if (!candidates.empty()) stray[i] = candidates[0].echo;
    }
    return stray;
}

/// Integral of angle^-3 over a round reflector ahead, as a sum over small squares.
double compute_integral_at(double azimuth_deg, double elevation_deg) {
    constexpr double kFine_deg = 0.05;
    double sum = 0.0;
    for (double a = -kRadius_deg; a < kRadius_deg; a += kFine_deg)
        for (double e = -kRadius_deg; e < kRadius_deg; e += kFine_deg)
            if (std::hypot(a, e) < kRadius_deg)
                sum += kFine_deg * kFine_deg / std::pow(std::hypot(a - azimuth_deg, e - elevation_deg), 3);
    return sum;
}

TEST(StrayLightOnScans, IsItsIntegralOverTheReflector) {
    const RenderedScan scan = make_wall_with({{0.0, 0.0, 4.0}});
    double sum = 0.0, squares = 0.0, n = 0.0;
    const auto expected_in = [](int column) {
        std::vector<double> of_row;
        for (int row = 0; row < kBeams; ++row)
            of_row.push_back(1e-4 * compute_integral_at(kStep_deg * (column - kSteps / 2 + 0.5),
                                                        kStep_deg * (kBeams / 2 - row - 0.5)));
        return of_row;
    };
    const std::vector<double> near = expected_in(kSteps / 2 + 24),
                              expected_far = expected_in(kSteps / 2 - 60);
    for (std::uint64_t seed = 0; seed < 40; ++seed) {
        const std::vector<LidarEcho> stray = compute_stray_light(scan, 1e-4, seed);
        ASSERT_EQ(stray.size(), scan.ring.size());
        EXPECT_EQ(stray[ray_at(kBeams / 2, kSteps / 2)].source, ReturnCause::nothing);
        for (int row = 0; row < kBeams; ++row) {
            const LidarEcho &here = stray[ray_at(row, kSteps / 2 + 24)],
                            &beside = stray[ray_at(row, kSteps / 2 - 60)];
            ASSERT_EQ(here.source, ReturnCause::blooming);
            ASSERT_NEAR(here.range_m, 4.0, 1e-6);
            const double deviate = here.reflectivity / near[std::size_t(row)];
            EXPECT_NEAR(beside.reflectivity / expected_far[std::size_t(row)] / deviate, 1.0, 0.15);
            sum += std::log(deviate);
            squares += std::log(deviate) * std::log(deviate);
            ++n;
        }
        const std::vector<LidarEcho> again = compute_stray_light(scan, 1e-4, seed);
        for (std::size_t i = 0; i < stray.size(); i += 97)
            ASSERT_EQ(stray[i].reflectivity, again[i].reflectivity);
    }
    EXPECT_NEAR(sum / n, 0.0, 4.0 * 3.0 / std::sqrt(n));
    EXPECT_NEAR(std::sqrt(squares / n), 3.0, 4.0 * 3.0 / std::sqrt(2.0 * n));
    EXPECT_TRUE(compute_stray_light(make_wall_with({}), 1e-4, 1).empty());
}

TEST(StrayLightOnScans, IsOfTheReflectorWithTheMostPower) {
    const RenderedScan scan = make_wall_with({{-8.0, 0.0, 4.0}, {8.0, 0.0, 8.0}});
    const std::vector<LidarEcho> stray = compute_stray_light(scan, 1e-4, 1);
    const int row = kBeams / 2 + 20;
    EXPECT_NEAR(stray[ray_at(row, kSteps / 2)].range_m, 4.0, 1e-6);
    EXPECT_NEAR(stray[ray_at(row, kSteps / 2 + 32)].range_m, 8.0, 1e-6);
}

TEST(StrayLightOnScans, TakesThePlaceOfWeakReturns) {
    RenderedScan scan = make_wall_with({{0.0, 0.0, 4.0}});
    const RenderedScan before = scan;
    const std::vector<LidarEcho> stray = compute_stray_light(scan, 1e-3, 1);
    add_weather(scan, {.weather = {.bloom = 1e-3}, .sensor = {}, .scan = scan, .response = {}, .seed = 1});
    const std::vector<std::int32_t>& source = *find_values<std::int32_t>(scan.channels, "source");
    int bloomed = 0;
    for (std::size_t i = 0; i < source.size(); ++i) {
        const double surface_power =
            double(before.image.intensity[i]) / std::pow(double(before.image.range_m[i]), 2);
        if (stray[i].reflectivity / 16.0 > surface_power) {
            ++bloomed;
            ASSERT_EQ(source[i], std::int32_t(ReturnCause::blooming));
            ASSERT_NEAR(scan.median_range_m[i], 4.0, 1e-5);
            ASSERT_EQ(scan.instance[i], -1);
        } else {
            ASSERT_EQ(source[i], std::int32_t(ReturnCause::surface));
            ASSERT_EQ(scan.median_range_m[i], before.median_range_m[i]);
        }
    }
    EXPECT_GT(bloomed, 100);
}

class GlareInScenes : public test::DeviceTest {};

TEST_F(GlareInScenes, TheSunIsNoiseAroundItUnlessAWallHidesIt) {
    const Config config;
    std::vector<double> elevations_rad;
    for (int beam = 0; beam < 8; ++beam) elevations_rad.push_back(kDegree * (2.5 - 0.5 * beam));
    const Log log = test::make_static_log(elevations_rad, 720);
    const Surfels disc = test::make_plate({12.0f, 0.0f, 0.0f}, glm::vec2(2.0f));
    ScanRenderer renderer(device(), wrap_background(disc), config, log);
    const SimulatedSensor sensor = make_sensor(config, log);
    const RenderedScan dark = renderer.render(sensor, 0.0, {}, 1);
    const auto noise_in = [&](const Sun& sun) {
        renderer.set_weather({.sun = sun});
        const RenderedScan scan = renderer.render(sensor, 0.0, {}, 1);
        return std::ranges::count(*find_values<std::int32_t>(scan.channels, "source"),
                                  std::int32_t(ReturnCause::noise));
    };
    EXPECT_EQ(noise_in({0.0, 0.5, 100.0}), 0) << "behind the wall";
    EXPECT_EQ(noise_in({0.0, 60.0, 100.0}), 0) << "far above the beams";
    renderer.set_weather({.sun = {180.0, 0.5, 100.0}});
    const RenderedScan scan = renderer.render(sensor, 0.0, {}, 1);
    const std::vector<std::int32_t>& source = *find_values<std::int32_t>(scan.channels, "source");
    int n = 0;
    for (std::size_t i = 0; i < source.size(); ++i) {
        const double off_deg =
            std::acos(std::min(double(scan.image.direction[i].x) * -std::cos(0.5 * kDegree) +
                                   double(scan.image.direction[i].z) * std::sin(0.5 * kDegree),
                               1.0)) /
            kDegree;
        if (source[i] == std::int32_t(ReturnCause::noise)) {
            ++n;
            ASSERT_LT(off_deg, 6.0);
        } else {
            ASSERT_GT(off_deg, 0.7) << "in the glare there is always noise";
            ASSERT_EQ(scan.median_range_m[i], dark.median_range_m[i]);
        }
    }
    EXPECT_GT(n, 5);
}

class WetGroundOnScans : public test::DeviceTest {};

/// Dark ground half a metre below the sensor, and a wall of intensity 0.5, 12 m ahead.
Surfels make_ground_before_wall() {
    Surfels scene = test::make_plate({12.0f, 0.0f, -0.5f}, glm::vec2(3.0f));
    Surfels disc = test::make_plate({}, glm::vec2(0.5f), true);
    disc.sh[0] = -1.4f;
    for (int x = -20; x < 12; ++x) {
        for (int y = -12; y <= 12; ++y) {
            disc.mean[0] = {float(x), float(y), -0.5f};
            scene.append_surfels(disc);
        }
    }
    return scene;
}

/// Eight beams that point down by 3.6 to 5.7 degrees.
Log make_log_looking_down() {
    std::vector<double> elevations_rad;
    for (int beam = 0; beam < 8; ++beam) elevations_rad.push_back(-kPi / 180.0 * (3.6 + 0.3 * beam));
    return test::make_static_log(elevations_rad, 360);
}

/// The point lies on the mirror image of the wall below the ground, if that is brighter
/// than the ground, which water darkens.
TEST_F(WetGroundOnScans, IsDarkerAndMirrorsAWall) {
    const Config config;
    const Log log = make_log_looking_down();
    ScanRenderer renderer(device(), wrap_background(make_ground_before_wall()), config, log);
    const SimulatedSensor sensor = make_sensor(config, log);
    const RenderedScan dry = renderer.render(sensor, 0.0);
    renderer.set_weather({.wet_mm = 2.0});
    const RenderedScan wet = renderer.render(sensor, 0.0);
    const std::vector<std::int32_t>& source = *find_values<std::int32_t>(wet.channels, "source");
    int mirrored = 0, darker = 0;
    for (std::size_t i = 0; i < source.size(); ++i) {
        const glm::vec3 d = wet.image.direction[i];
        const double ground_m = 0.5 / -double(d.z), wall_m = 12.0 / double(d.x);
        if (dry.median_range_m[i] == 0.0f || ground_m > 11.0) continue;
        ASSERT_NEAR(dry.median_range_m[i], ground_m, 0.02);
        if (source[i] == std::int32_t(ReturnCause::mirror)) {
            ++mirrored;
            ASSERT_GT(d.x, 0.0f);
            ASSERT_NEAR(wet.median_range_m[i], wall_m, 0.2) << "the tracing begins 0.1 m above the ground";
            ASSERT_EQ(wet.instance[i], -1);
            const double up_m = (wall_m - ground_m) * -double(d.z), left_m = wall_m * double(d.y);
            const double wall =
                0.5 / (1.0 + std::exp(-6.0)) * std::exp(-0.5 * (up_m * up_m + left_m * left_m) / 9.0);
            ASSERT_NEAR(wet.image.intensity[i], wall * std::pow(water_reflectance(-double(d.z)), 2), 0.02);
        } else if (source[i] == std::int32_t(ReturnCause::surface)) {
            ++darker;
            ASSERT_EQ(wet.median_range_m[i], dry.median_range_m[i]);
            ASSERT_NEAR(wet.image.intensity[i] / dry.image.intensity[i],
                        wet_ratio(-double(d.z), double(dry.image.intensity[i])),
                        // close to the foot of the wall, the tolerance is larger, because
                        // the estimated ground is tilted
                        ground_m * double(d.x) < 6.0 ? 1e-3 : 0.05)
                << i;
        }
    }
    EXPECT_GT(mirrored, 20);
    EXPECT_GT(darker, 1000);
    renderer.set_weather({});
    EXPECT_EQ(renderer.render(sensor, 0.0).image.intensity, dry.image.intensity);
}

/// The range to the mirror image falls by the speed of the sensor along the ray.
TEST_F(WetGroundOnScans, MirrorImagesHaveTheVelocityOfTheirObjects) {
    Config config;
    config.render.channels = "velocity";
    Log log = make_log_looking_down();
    log.world_from_vehicle = {{-1.0, 1.0},
                              {Pose{{1, 0, 0, 0}, {-8.0, 0.0, 0.0}}, Pose{{1, 0, 0, 0}, {8.0, 0.0, 0.0}}}};
    ScanRenderer renderer(device(), wrap_background(make_ground_before_wall()), config, log);
    renderer.set_weather({.wet_mm = 2.0});
    const RenderedScan wet = renderer.render(make_sensor(config, log), 0.0);
    const std::vector<std::int32_t>& source = *find_values<std::int32_t>(wet.channels, "source");
    int mirrored = 0;
    for (std::size_t i = 0; i < source.size(); ++i) {
        if (source[i] != std::int32_t(ReturnCause::mirror)) continue;
        ++mirrored;
        ASSERT_NEAR(find_values<float>(wet.channels, "velocity")->at(i),
                    -8.0 * double(wet.image.direction[i].x), 1e-3);
    }
    EXPECT_GT(mirrored, 20);
}

}  // namespace

}  // namespace relidar
