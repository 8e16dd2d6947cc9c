// SPDX-License-Identifier: Apache-2.0
// Tests sunlight and stray light along single rays. Compares them with closed forms and
// the statistics of their models.

#include <gtest/gtest.h>

#include "one_ray.hpp"

namespace relidar {
namespace {

constexpr int kPulses = 100'000;
constexpr double kDegree = kPi / 180.0, kLight_m_s = 299792458.0;

using test::compute_chi2_deviate, test::echoes, test::echoes_of, test::make_air_with, test::make_sensor_to,
    test::surface_at;

/// Returns a sensor with pulses of 6 m length that detects a reflectivity of at least
/// 0.005 at 60 m.
WeatherSensorProperties make_sensor_to_60_m() {
    WeatherSensorProperties sensor = make_sensor_to(60.0);
    sensor.pulse_s = 6.0 / kLight_m_s;
    return sensor;
}

/// Returns the air for a ray whose direction differs from the direction of the sun by an
/// angle.
WeatherRaySimulator make_air_beside_sun(double off_deg, double klux, const WeatherSensorProperties& sensor,
                                        float hides_sun = 0.0f) {
    return test::make_air_of({.sun = {off_deg, 0.0, klux}}, sensor, hides_sun);
}

/// Compares with photons counted by hand: 0.65 W/m^2/nm through a filter of 20 nm, an
/// aperture of 1e-3 m^2 and 7.07e-6 sr. About 10 nJ of light produce the electrons of a
/// pulse.
TEST(Sunlight, IsShotNoiseOfItsPhotons) {
    WeatherSensorProperties sensor;
    sensor.divergence_rad = 0.003;
    sensor.pulse_s = 6e-9;
    const double photon_J = 6.626e-34 * 299792458.0 / 905e-9, view_sr = kPi * 0.0015 * 0.0015;
    const auto expected = [&](double W_m2_sr_nm) {
        const double electrons = W_m2_sr_nm * 20.0 * 1e-3 * view_sr * 6e-9 * 0.7 / photon_J;
        const double of_signal = 75.0 * 1e-3 / kPi * 6e-9 * 0.7 / photon_J;
        return std::sqrt(3.0 * electrons) / of_signal;
    };
    const Sun sun{0.0, 0.0, 100.0}, half{0.0, 0.0, 50.0};
    const double disc_sr = kPi * 4.65e-3 * 4.65e-3, glare = 5.0 * std::pow(kDegree / 4.65e-3, 2);
    const auto relative = [&](const Sun& from, double off_rad, double albedo, bool sees_sky, double light) {
        return sun_noise(from, sensor, off_rad, albedo, sees_sky) / expected(light);
    };
    EXPECT_NEAR(relative(sun, 2.0 * kDegree, 0.0, true, 0.65 * 1.25), 1.0, 1e-3);
    EXPECT_NEAR(relative(half, 2.0 * kDegree, 0.0, true, 0.325 * 1.25), 1.0, 1e-3);
    EXPECT_NEAR(relative(sun, 2.0 * kDegree, 0.4, false, 0.65 * (1.25 + 0.4 / kPi)), 1.0, 1e-3);
    EXPECT_NEAR(relative(sun, 0.0, 0.0, true, 0.65 * (glare + 1.0 / disc_sr)), 1.0, 1e-3);
    EXPECT_NEAR(relative(sun, 4.65e-3, 0.0, true, 0.65 * (glare + 0.5 / disc_sr)), 1.0, 1e-3) << "half of it";
    EXPECT_NEAR(relative(sun, 0.0, 0.0, false, 0.65 * glare), 1.0, 1e-3) << "something is before it";
}

/// Compares the rate of false returns with Rice's rate of level crossings, integrated
/// over the time in which the sensor accepts returns.
TEST(Sunlight, IsFalseReturnsAsOftenAsRiceSays) {
    const WeatherSensorProperties sensor = make_sensor_to_60_m();
    const double seconds = 2.0 * (60.0 - 1.0) / kLight_m_s;
    for (const double off_deg : {0.35, 0.4, 0.5}) {
        const double level =
            sensor.floor_power() / sun_noise({0.0, 0.0, 100.0}, sensor, off_deg * kDegree, 0.0, true);
        const double n = seconds / (2.0 * std::sqrt(3.0) * sensor.pulse_s) * std::exp(-0.5 * level * level);
        const WeatherRaySimulator air = make_air_beside_sun(off_deg, 100.0, sensor);
        std::vector<double> counts(21), expected(21, kPulses * (1.0 - std::exp(-n)) / 20.0);
        expected.back() = kPulses * std::exp(-n);
        for (std::uint64_t seed = 0; seed < kPulses; ++seed) {
            const LidarEcho echo = echoes(air, 60.0, seed).strongest;
            if (echo.source == ReturnCause::nothing) ++counts.back();
            else {
                ASSERT_EQ(echo.source, ReturnCause::noise);
                ASSERT_GE(power_of(echo), sensor.floor_power());
                ++counts.at(std::size_t((echo.range_m - 1.0) / 59.0 * 20.0));  // uniform over the range
            }
        }
        ASSERT_GT(expected.front(), 20.0) << off_deg;
        EXPECT_LT(std::abs(compute_chi2_deviate(counts, expected)), 4.0) << off_deg;
    }
}

/// Noise of sunlight hides a target of power S if the noise is stronger. This happens in
/// 1 - exp(-N exp(-S^2 / 2 sigma^2)) of the scans, where N is the number of noise crests.
/// Half of the targets are hidden at R = sqrt(rho / S), S = sigma sqrt(2 ln(N / ln 2)).
TEST(Sunlight, HidesWeakTargets) {
    WeatherSensorProperties sensor = make_sensor_to_60_m();
    sensor.darkest = 0.0005;
    const Sun sun{0.0, 0.0, 100.0};
    const WeatherRaySimulator air = make_air_beside_sun(0.3, 100.0, sensor);
    for (const double reflectivity : {0.002, 0.004}) {
        const double sigma = sun_noise(sun, sensor, 0.3 * kDegree, reflectivity, false);
        const double crests = 2.0 * 59.0 / kLight_m_s / (2.0 * std::sqrt(3.0) * sensor.pulse_s);
        const double half_m =
            std::sqrt(reflectivity / (sigma * std::sqrt(2.0 * std::log(crests / std::log(2.0)))));
        ASSERT_LT(half_m, 60.0);
        for (const double range_m : {0.8 * half_m, half_m, 1.1 * half_m}) {
            const double power = reflectivity / (range_m * range_m);
            const double lost = 1.0 - std::exp(-crests * std::exp(-0.5 * power * power / (sigma * sigma)));
            double n = 0.0;
            for (std::uint64_t seed = 0; seed < kPulses; ++seed)
                n += echoes_of(air, surface_at(range_m, reflectivity), seed).strongest.source ==
                     ReturnCause::noise;
            EXPECT_NEAR(n / kPulses, lost, 4.0 * std::sqrt(lost * (1.0 - lost) / kPulses)) << range_m;
            EXPECT_TRUE(range_m != half_m || std::abs(lost - 0.5) < 1e-9);
        }
    }
}

TEST(Sunlight, ElsewhereChangesNothing) {
    const WeatherSensorProperties sensor = make_sensor_to_60_m();
    const WeatherRaySimulator blind = make_air_beside_sun(0.0, 150.0, sensor);
    for (std::uint64_t seed = 0; seed < 1000; ++seed)
        ASSERT_EQ(echoes(blind, 0.0, seed).strongest.source, ReturnCause::nothing)
            << "what is at the sensor hides it";
    const LidarEcho before = surface_at(20.0, 0.3);
    for (const auto& [off_deg, hides_sun] : {std::pair(8.0, 0.0f), {90.0, 0.0f}, {0.0, 1.0f}}) {
        const WeatherRaySimulator air = make_air_beside_sun(off_deg, 150.0, sensor, hides_sun);
        for (std::uint64_t seed = 0; seed < 1000; ++seed) {
            const EchoPair pair = echoes_of(air, before, seed);
            ASSERT_EQ(pair.strongest.source, ReturnCause::surface);
            ASSERT_EQ(pair.strongest.reflectivity, before.reflectivity);
            ASSERT_EQ(echoes(air, 60.0, seed).strongest.source, ReturnCause::nothing);
        }
    }
}

/// The stronger of two echoes must be returned. A reflectivity of 0.002 at 4 m has the
/// same power as a reflectivity of 0.05 at 20 m.
TEST(StrayLight, WinsOverWhatIsWeaker) {
    const WeatherSensorProperties sensor = make_sensor_to_60_m();
    LidarEcho stray{4.0, 0.002, ReturnCause::blooming};
    const WeatherRaySimulator air = make_air_with(sensor, stray);
    const EchoPair lost = echoes_of(air, surface_at(20.0, 0.049), 1);
    EXPECT_EQ(lost.strongest.source, ReturnCause::blooming);
    EXPECT_EQ(lost.strongest.range_m, 4.0);
    EXPECT_EQ(lost.strongest.reflectivity, 0.002);
    EXPECT_EQ(lost.second.source, ReturnCause::surface);
    EXPECT_EQ(echoes_of(air, surface_at(20.0, 0.051), 1).strongest.source, ReturnCause::surface);
    EXPECT_EQ(echoes(air, 60.0, 1).strongest.source, ReturnCause::blooming);
    stray.reflectivity = 0.9 * 0.005 * 16.0 / 3600.0;
    EXPECT_EQ(echoes(make_air_with(sensor, stray), 60.0, 1).strongest.source, ReturnCause::nothing)
        << "too weak to be a return; a dark surface counts as darkest";
}

}  // namespace
}  // namespace relidar
