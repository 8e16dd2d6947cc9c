// SPDX-License-Identifier: Apache-2.0
// Tests which returns of a ray a sensor reports in weather: where the air returns, and
// the second return.

#include <gtest/gtest.h>

#include "one_ray.hpp"

namespace relidar {
namespace {

using test::echoes, test::echoes_of, test::make_air_of, test::make_air_with, test::make_sensor_to,
    test::surface_at;

/// Returns the integral of 2 c function(c) over the cosine c, which is the mean over a
/// diffuse surface.
double average_over_dull_surface(const std::function<double(double)>& function) {
    double sum = 0.0;
    for (int i = 0; i < 20'000; ++i) sum += 2.0 * (i + 0.5) / 20'000 * function((i + 0.5) / 20'000) / 20'000;
    return sum;
}

TEST(WetGround, WaterMirrorsAsFresnelSays) {
    constexpr double n = 1.33;
    EXPECT_NEAR(water_reflectance(1.0), std::pow((n - 1.0) / (n + 1.0), 2), 1e-12);
    EXPECT_NEAR(water_reflectance(0.0), 1.0, 1e-12);
    // At Brewster's angle, only light that is polarised perpendicular to the plane of
    // incidence is reflected.
    const double brewster = std::cos(std::atan(n));
    EXPECT_NEAR(water_reflectance(brewster), 0.5 * std::pow((n * n - 1.0) / (n * n + 1.0), 2), 1e-12);
    EXPECT_NEAR(average_over_dull_surface(water_reflectance), 0.066, 0.001)
        << "the diffuse reflectance of water in tables";
}

/// Compares with the sum over all reflections between the ground and the surface of the
/// water film. The light that is reflected back into the water is an integral over
/// directions with total reflection. The closed form does not use this integral.
TEST(WetGround, IsDarkerByTheSumOfItsBounces) {
    constexpr double n = 1.33;
    const auto compute_internal_reflectance = [](double in_water) {
        const double squared = 1.0 - n * n * (1.0 - in_water * in_water);
        return squared <= 0.0 ? 1.0 : water_reflectance(std::sqrt(squared));
    };
    const double internal_reflectance = average_over_dull_surface(compute_internal_reflectance);
    for (const double albedo : {0.0, 0.1, 0.4, 0.9}) {
        for (const double cosine : {1.0, 0.5, 0.1, 0.03}) {
            const double passes = 1.0 - water_reflectance(cosine);
            double light = passes, returned = 0.0;  // per albedo
            for (int bounce = 0; bounce < 2000; ++bounce) {
                returned += light;
                light *= albedo * internal_reflectance;
            }
            EXPECT_NEAR(wet_ratio(cosine, albedo), returned * passes / (n * n), 1e-3)
                << cosine << ' ' << albedo;
        }
    }
    EXPECT_EQ(film_fraction(0.0), 0.0);
    EXPECT_EQ(film_fraction(0.25), 0.25);
    EXPECT_EQ(film_fraction(3.0), 1.0);
}

/// The sensor detects a reflectivity of at least 0.005 at 80 m.
TEST(WetGround, WhatIsTooDarkLeavesToWhatItMirrors) {
    const LidarEcho ground = surface_at(40.0, 0.1), mirrored{60.0, 0.5, ReturnCause::mirror};
    // the power is 0.001 at 40 m, which is less than the weakest detectable power 0.00125
    const EchoPair echoes = echoes_of(make_air_with(make_sensor_to(80.0), mirrored, 0.5, 0.01), ground, 1);
    EXPECT_EQ(echoes.strongest.source, ReturnCause::mirror);
    EXPECT_EQ(echoes.strongest.range_m, 60.0);
    EXPECT_EQ(echoes.strongest.reflectivity, 0.25);
    EXPECT_EQ(echoes.second.source, ReturnCause::nothing);
    const EchoPair both = echoes_of(make_air_with(make_sensor_to(80.0), mirrored, 0.5, 0.9), ground, 1);
    EXPECT_EQ(both.strongest.source, ReturnCause::mirror) << "0.25 / 60^2 is more than 0.09 / 40^2";
    EXPECT_EQ(both.second.source, ReturnCause::surface);
    EXPECT_EQ(both.second.reflectivity, 0.1 * 0.9);
}

TEST(WetGround, MirrorsNothingBeyondTheSensorsRange) {
    const WeatherRaySimulator air = make_air_with(make_sensor_to(80.0), {84.5, 0.5, ReturnCause::mirror});
    const EchoPair echoes = echoes_of(air, surface_at(40.0, 0.1), 1);
    EXPECT_EQ(echoes.strongest.source, ReturnCause::surface);
    EXPECT_EQ(echoes.second.source, ReturnCause::nothing);
}

/// Without weather, the returns of a ray are those of clear air: the first is the
/// stronger surface, even if noise has changed its intensity, or if both are black.
TEST(Weather, ClearAirKeepsReturns) {
    WeatherSensorProperties sensor = make_sensor_to(80.0);
    sensor.weakest_reflectivity = 0.0025;
    const WeatherRaySimulator air(Weather{}, sensor, {});
    Random random(3);
    for (std::uint64_t seed = 0; seed < 2000; ++seed) {
        const auto sample_surface = [&] {
            const double brightness = random.sample_uniform(-0.3, 0.5);
            return surface_at(random.sample_uniform(2.0, 80.0), std::max(brightness, 0.0));
        };
        const LidarEcho first = sample_surface(), second = sample_surface();
        const EchoPair pair = echoes(air, 80.0, seed, first, second);
        EXPECT_EQ(pair.strongest.range_m, first.range_m);
        EXPECT_EQ(pair.strongest.reflectivity, first.reflectivity);
        EXPECT_EQ(pair.second.range_m, second.range_m);
        EXPECT_EQ(pair.second.reflectivity, second.reflectivity);
    }
}

/// Noise has made the first surface weaker than the second, which is nearer and so loses
/// less light.
TEST(Weather, ThinFogKeepsTheOrderOfReturns) {
    const WeatherRaySimulator air = make_air_of({.fog_visibility_m = 1e6}, make_sensor_to(80.0));
    const EchoPair pair = echoes(air, 50.0, 1, surface_at(50.0, 0.4), surface_at(20.0, 0.1));
    EXPECT_EQ(pair.strongest.range_m, 50.0);
    EXPECT_EQ(pair.second.range_m, 20.0);
}

/// In fog, the far surface loses a factor of exp(-2 alpha (40 m - 10 m)) more than the
/// near surface. The order changes where this cancels the difference in clear air.
TEST(Weather, FogPrefersTheNearerSurface) {
    const Weather weather{.fog_visibility_m = 500.0};
    const WeatherRaySimulator air = make_air_of(weather, make_sensor_to(80.0));
    const double ratio = std::exp(-2.0 * extinction_per_m(weather) * 30.0);
    for (const double excess : {0.97, 1.03}) {
        // In clear air, the ratio of the far and the near power is excess / ratio.
        const LidarEcho far = surface_at(40.0, 0.8), near = surface_at(10.0, 0.8 / 16.0 * ratio / excess);
        EXPECT_EQ(echoes(air, 40.0, 1, far, near).strongest.range_m, excess > 1.0 ? 40.0 : 10.0);
    }
}

/// The last return is the second return if it has a tenth of the power of the strongest.
TEST(Weather, TwoReturnsAreThePeakAndTheLast) {
    const WeatherSensorProperties sensor = make_sensor_to(80.0);
    const WeatherRaySimulator air = make_air_of({.fog_visibility_m = 60.0}, sensor);
    const double of_wall = 0.3 * std::exp(-2.0 * std::log(20.0) / 60.0 * 20.0) / 400.0;
    int behind = 0, hidden = 0, before = 0, alone = 0;
    for (std::uint64_t seed = 0; seed < 500; ++seed) {
        const EchoPair far_echoes = echoes_of(air, surface_at(20.0, 0.3), seed),
                       near_echoes = echoes(air, 1.6, seed, surface_at(1.2, 0.9));
        if (far_echoes.strongest.source == ReturnCause::fog) {
            const bool is_seen = of_wall >= 0.1 * power_of(far_echoes.strongest);
            EXPECT_EQ(far_echoes.second.source == ReturnCause::surface, is_seen);
            ++(is_seen ? behind : hidden);
        } else {
            EXPECT_NE(far_echoes.second.source, ReturnCause::surface) << "nothing is behind the wall";
        }
        before += far_echoes.second.source == ReturnCause::fog;
        EXPECT_LE(std::max(far_echoes.strongest.range_m, far_echoes.second.range_m), 20.0);
        if (far_echoes.second.source != ReturnCause::nothing) {
            EXPECT_GE(std::abs(far_echoes.strongest.range_m - far_echoes.second.range_m),
                      sensor.separation_m);
            EXPECT_GE(power_of(far_echoes.second), 0.1 * power_of(far_echoes.strongest));
        }
        alone += near_echoes.second.source == ReturnCause::nothing;
    }
    EXPECT_GT(behind, 100);
    EXPECT_GT(hidden, 100);
    EXPECT_GT(before, 50);
    EXPECT_EQ(alone, 500) << "what is nearer than returns can be told apart is one";
}

/// In fog of 200 m, sensors in chambers report fog within 10 to 25 m. For the data sheets
/// of a VLP-16 and an HDL-64E, the model must not report fog beyond 25 m, except for one
/// ray in a thousand. In fog of 1 km, fewer than 0.5 % of the rays into the sky return.
TEST(ThinWeather, FogReturnsFromNearbyOnly) {
    for (const double max_range_m : {100.0, 120.0}) {
        const WeatherSensorProperties sensor{.max_range_m = max_range_m,
                                             .weakest_reflectivity = 0.0025,
                                             .min_specified_power = 0.8 / (max_range_m * max_range_m)};
        const auto count = [&](double visibility_m, double beyond_m) {
            const WeatherRaySimulator air = make_air_of({.fog_visibility_m = visibility_m}, sensor);
            int n = 0;
            for (std::uint64_t seed = 0; seed < 20'000; ++seed)
                n += echoes(air, 80.0, seed).strongest.range_m > beyond_m;
            return n;
        };
        EXPECT_GT(count(200.0, 0.0), 400) << max_range_m;
        EXPECT_LT(count(200.0, 25.0), 20) << max_range_m;
        EXPECT_LT(count(1000.0, 0.0), 100) << max_range_m;
    }
}

}  // namespace

}  // namespace relidar
