// SPDX-License-Identifier: Apache-2.0
// Tests weather along single rays. Compares it with closed forms and with the integrals
// of its models, which this file implements separately from the literature.
#include <sstream>

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>

#include "one_ray.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

constexpr double kCell_m = 0.05, kNearest_m = 1.0;
constexpr int kLevels = 400, kRays = 100'000;

using test::echoes, test::echoes_of, test::make_air_of, test::make_sensor_to, test::surface_at;

double weakest(const WeatherSensorProperties& sensor) {
    return 0.005 / (sensor.max_range_m * sensor.max_range_m);
}

bool shows_surface(const EchoPair& pair) {
    return pair.strongest.source == ReturnCause::surface || pair.second.source == ReturnCause::surface;
}

/// Solves x e^x = y for x by Newton's method.
double evaluate_lambert_w(double y) {
    double x = std::log1p(y);
    for (int i = 0; i < 50; ++i) x -= (x * std::exp(x) - y) / ((1.0 + x) * std::exp(x));
    return x;
}

TEST(Weather, IsReadAsItIsWritten) {
    EXPECT_TRUE(parse_weather("").is_clear());
    EXPECT_TRUE(parse_weather("clear").is_clear());
    EXPECT_TRUE(parse_weather("rain=0").is_clear());
    EXPECT_EQ(parse_weather("fog=50").fog_visibility_m, 50.0);
    EXPECT_EQ(parse_weather("rain=2.5").rain_mm_h, 2.5);
    const Weather both = parse_weather("fog=120, snow=1.5");
    EXPECT_EQ(both.fog_visibility_m, 120.0);
    EXPECT_EQ(both.snow_mm_h, 1.5);
    EXPECT_EQ(parse_weather("bloom").bloom, 1.2e-4);
    EXPECT_EQ(parse_weather("sun=-30:20").sun, (Sun{-30.0, 20.0, 100.0}));
    EXPECT_EQ(parse_weather("sun=200.5:0:40").sun, (Sun{200.5, 0.0, 40.0}));
    for (const char* text : {"clear", "fog=50", "rain=2.5", "fog=120.5,snow=0.1", "rain=4,wet=0.5",
                             "bloom=0.001,sun=-30:20", "sun=200.5:0:40"})
        EXPECT_EQ(format_weather(parse_weather(text)), text);
}

TEST(Weather, EachRowOfTheTableIsComplete) {
    for (const WeatherEffectEntry* effect : kWeatherEffects) {
        EXPECT_NE(weather_help().find(effect->form), std::string::npos) << effect->form;
        EXPECT_TRUE(effect->form.starts_with(effect->name)) << effect->form;
        EXPECT_NE(effect->prepare, nullptr) << effect->name;
        EXPECT_FALSE(effect->is_active({})) << effect->name;
        std::istringstream examples{std::string(effect->examples)};
        int n = 0;
        for (std::string example; examples >> example; ++n)
            EXPECT_TRUE(effect->is_active(parse_weather(example))) << example;
        EXPECT_GT(n, 0) << effect->name;
    }
}

TEST(Weather, WhatIsNoneIsRefused) {
    for (const std::string text :
         {"fog=0",       "fog=-5",    "fog=",     "rain=-1",   "rain=nan",    "snow=1e9",
          "bloom=",      "fog=50:60", "rain=5mm", "wet=11",    "fog",         "sun",
          "spray=1",     "bloom=-1",  "sun=10",   "sun=10:-5", "sun=10:20:0", "sun=10:20:30:40",
          "sun=east:20", "hail=3"})
        EXPECT_THAT([&] { parse_weather(text); }, testing::ThrowsMessage<UsageError>(test::Names(text)));
    for (const char* text : {"rain=1,snow=2", "fog=50,fog=60", "sun=10:20,sun=10:20"})
        EXPECT_THROW(parse_weather(text), UsageError) << text;
    EXPECT_THROW(make_air_of({.rain_mm_h = -1.0}), UsageError);
    EXPECT_THROW(make_air_of({.fog_visibility_m = std::nan("")}), UsageError);
    EXPECT_THROW(make_air_of({.sun = {0.0, std::nan(""), 100.0}}), UsageError);
}

TEST(Weather, FogLeavesATwentiethAfterItsVisibility) {
    EXPECT_NEAR(std::exp(-extinction_per_m({.fog_visibility_m = 70.0}) * 70.0), 0.05, 1e-12);
    EXPECT_EQ(extinction_per_m({}), 0.0);
}

/// The extinction must be twice the total cross-section area of all particles. The test
/// integrates over the particle diameters in small steps.
TEST(Weather, ParticlesTakeTwiceTheirShadow) {
    const auto shadows = [](double n0, double slope, double widening) {
        double sum = 0.0;
        for (double mm = 0.0005; mm < 40.0; mm += 0.001)
            sum += n0 * std::exp(-slope * mm) * 2.0 * kPi / 4.0 * std::pow(1e-3 * widening * mm, 2) * 0.001;
        return sum;
    };
    for (const double rate : {0.5, 5.0, 25.0}) {
        const double rain = shadows(8000.0, 4.1 * std::pow(rate, -0.21), 1.0),
                     snow = shadows(3.8e3 * std::pow(rate, -0.87), 2.55 * std::pow(rate, -0.48),
                                    std::pow(10.0, 1.0 / 3.0));
        EXPECT_NEAR(extinction_per_m({.rain_mm_h = rate}), rain, 1e-4 * rain);
        EXPECT_NEAR(extinction_per_m({.snow_mm_h = rate}), snow, 1e-4 * snow);
        EXPECT_NEAR(extinction_per_m({.fog_visibility_m = 100.0, .rain_mm_h = rate}),
                    std::log(20.0) / 100.0 + rain, 1e-4 * rain);
    }
}

/// A target of 10 % must be visible up to the range R at which 0.1 exp(-2 alpha R) / R^2
/// equals the weakest power. With Lambert's W, R = W(alpha sqrt(0.1 / weakest)) / alpha.
/// The second sensor has the data sheet of the HDL-64E: 80 % at 120 m. The air returns no
/// light, because it would hide targets.
TEST(Weather, ATenthVanishesWhereItsPowerDoes) {
    WeatherSensorProperties hdl64e = make_sensor_to(120.0);
    hdl64e.min_specified_power = 0.8 / (120.0 * 120.0);
    for (const double visibility_m : {30.0, 50.0, 150.0, 400.0})
        for (const auto& [sensor, least] :
             {std::pair(make_sensor_to(100.0), 0.005 / (100.0 * 100.0)), {hdl64e, 0.8 / (120.0 * 120.0)}}) {
            const WeatherRaySimulator air({.fog_visibility_m = visibility_m}, sensor, {});
            const double alpha = std::log(20.0) / visibility_m,
                         end_m = evaluate_lambert_w(alpha * std::sqrt(0.1 / least)) / alpha;
            for (const double side : {0.999, 1.001})
                EXPECT_EQ(shows_surface(echoes_of(air, surface_at(side * end_m, 0.1), 1)), side < 1.0)
                    << visibility_m << ' ' << least;
        }
}

/// Expected distribution of range and power of the strongest return from the air, without
/// a surface.
class FreeAir {
public:
    FreeAir(const Weather& weather, const WeatherSensorProperties& sensor)
        : sensor_(sensor), alpha_(extinction_per_m(weather)) {
        for (double r = kNearest_m + 0.5 * kCell_m; r < sensor.max_range_m; r += kCell_m)
            ranges_m_.push_back(r);
        for (int i = 0; i <= kLevels; ++i)
            levels_.push_back(weakest(sensor) * std::pow(10.0, 7.0 * i / kLevels));
        from_.resize(ranges_m_.size());
        none_stronger_.resize(levels_.size());
    }
    /// Computes the distribution for particles.
    /// @param brighter brighter(r, q) is the number of particles per metre at range r
    /// whose return is stronger than q
    void count_particles(const std::function<double(double, double)>& brighter) {
        std::vector<std::vector<double>> n(levels_.size());
        for (std::size_t i = 0; i < levels_.size(); ++i) {
            double all = 0.0;
            for (const double r : ranges_m_) {
                n[i].push_back(brighter(r, levels_[i]) * kCell_m);
                all += n[i].back();
            }
            none_stronger_[i] = std::exp(-all);
        }
        for (std::size_t i = 0; i + 1 < levels_.size(); ++i)
            for (std::size_t k = 0; k < ranges_m_.size(); ++k)
                from_[k] += (n[i][k] - n[i + 1][k]) * 0.5 * (none_stronger_[i] + none_stronger_[i + 1]);
    }
    /// Computes the distribution if each section of the ray has a return at a random
    /// position. The power of the return is log-normal with mean 1, times mean(r).
    /// Sections end at cells.
    void count_stretches(std::size_t cells, const std::function<double(double)>& mean) {
        const std::size_t n = ranges_m_.size() / cells;
        // P(power < level)
        std::vector<double> mean_of_cell, stretch(n), next(n), cell(n * cells), next_cell(n * cells);
        for (std::size_t k = 0; k < n * cells; ++k) mean_of_cell.push_back(mean(ranges_m_[k]));
        for (std::size_t i = 0; i < levels_.size(); ++i) {
            std::ranges::fill(next, 0.0);
            for (std::size_t k = 0; k < n * cells; ++k) {
                next_cell[k] = 0.5 *
                               std::erfc(-(std::log(levels_[i] / mean_of_cell[k]) + 0.5) / std::sqrt(2.0)) /
                               double(cells);
                next[k / cells] += next_cell[k];
            }
            none_stronger_[i] = 1.0;
            for (const double p : next) none_stronger_[i] *= p;
            for (std::size_t k = 0; i > 0 && k < n * cells; ++k)
                from_[k] +=
                    (next_cell[k] - cell[k]) * 0.5 *
                    (none_stronger_[i] / next[k / cells] + none_stronger_[i - 1] / stretch[k / cells]);
            stretch = next;
            cell = next_cell;
        }
    }
    double alpha() const { return alpha_; }
    double beam_width_m(double r) const { return sensor_.aperture_m + sensor_.divergence_rad * r; }
    void expect_as(const WeatherRaySimulator& air, ReturnCause source) const;

private:
    const WeatherSensorProperties sensor_;
    const double alpha_;
    std::vector<double> ranges_m_, levels_;
    std::vector<double> from_;           // [cells] probability that the strongest return comes from the cell
    std::vector<double> none_stronger_;  // [levels] probability that no return is stronger
};

/// Returns compute_chi2_deviate() of bins that have at least 100 expected counts each.
double compute_deviation(const std::vector<double>& counts, const std::vector<double>& probabilities) {
    double in_bin = 0.0, of_bin = 0.0, sum = 0.0;
    std::vector<double> binned, expected;
    for (std::size_t k = 0; k < counts.size(); ++k) {
        in_bin += counts[k];
        of_bin += kRays * probabilities[k];
        sum += probabilities[k];
        if (of_bin < 100.0 && k + 1 < counts.size()) continue;
        binned.push_back(in_bin);
        expected.push_back(std::max(of_bin, 1.0));
        in_bin = of_bin = 0.0;
    }
    EXPECT_NEAR(sum, 1.0, 1e-6);
    EXPECT_GT(binned.size(), 30u);
    return test::compute_chi2_deviate(binned, expected);
}

constexpr double kMostDeviation = 3.5;  // exceeded by chance in 1 of 4000 cases

void FreeAir::expect_as(const WeatherRaySimulator& air, ReturnCause source) const {
    std::vector<double> ranges(from_.size() + 1), powers(levels_.size()), from = from_,
                                                                          stronger{none_stronger_[0]};
    double any = 0.0;
    for (const double p : from_) any += p;
    from.push_back(1.0 - any);  // no return
    for (std::size_t i = 1; i < levels_.size(); ++i)
        stronger.push_back(none_stronger_[i] - none_stronger_[i - 1]);
    for (std::uint64_t seed = 0; seed < kRays; ++seed) {
        const LidarEcho echo = echoes(air, sensor_.max_range_m, seed).strongest;
        if (echo.source == ReturnCause::nothing) {
            ranges.back() += 1.0;
            powers.front() += 1.0;
            continue;
        }
        ASSERT_EQ(echo.source, source);
        ranges.at(std::size_t((echo.range_m - kNearest_m) / kCell_m)) += 1.0;
        const double level = std::log10(power_of(echo) / levels_[0]) / 7.0 * kLevels;
        powers.at(std::size_t(std::max(std::ceil(level), 1.0))) += 1.0;
    }
    EXPECT_LT(compute_deviation(ranges, from), kMostDeviation);
    EXPECT_LT(compute_deviation(powers, stronger), kMostDeviation);
}

TEST(Weather, RainReturnsAsItsIntegral) {
    for (const double rate : {5.0, 25.0}) {
        const WeatherSensorProperties sensor = make_sensor_to(60.0);
        FreeAir model({.rain_mm_h = rate}, sensor);
        const double slope = 4.1 * std::pow(rate, -0.21);
        model.count_particles([&](double r, double power) {
            const double share = power * r * r * std::exp(2.0 * model.alpha() * r) / 0.02;
            if (share > 1.0) return 0.0;
            const double mm = 1000.0 * model.beam_width_m(r) * std::sqrt(share);
            return kPi / 4.0 * std::pow(model.beam_width_m(r), 2) * 8000.0 / slope * std::exp(-slope * mm);
        });
        model.expect_as(make_air_of({.rain_mm_h = rate}, sensor), ReturnCause::rain);
    }
}

TEST(Weather, SnowReturnsAsItsIntegral) {
    const double rate = 1.0;
    WeatherSensorProperties sensor = make_sensor_to(60.0);
    sensor.divergence_rad = 0.0015;
    FreeAir model({.snow_mm_h = rate}, sensor);
    model.count_particles([&](double r, double power) {
        const double share = power * r * r * std::exp(2.0 * model.alpha() * r) / 0.25;
        if (share > 1.0) return 0.0;
        const double melted_mm =
            1000.0 * model.beam_width_m(r) * std::sqrt(share) / std::pow(10.0, 1.0 / 3.0);
        return kPi / 4.0 * std::pow(model.beam_width_m(r), 2) * 3800.0 / 2.55 * std::exp(-2.55 * melted_mm);
    });
    model.expect_as(make_air_of({.snow_mm_h = rate}, sensor), ReturnCause::snow);
}

/// Compares with the integral of fog over the pulse, computed by Simpson's rule. A pulse
/// is 6 m long, so that a section of 3 m ends at the border of a cell.
TEST(Weather, FogReturnsAsItsIntegral) {
    for (const double visibility_m : {50.0, 200.0}) {
        WeatherSensorProperties sensor = make_sensor_to(61.0);
        sensor.pulse_s = 6.0 / 299792458.0;
        FreeAir model({.fog_visibility_m = visibility_m}, sensor);
        const auto mean = [&](double range_m) {
            constexpr int kSteps = 400;
            const double begin = std::max(range_m - 3.0, kNearest_m), step = (range_m + 3.0 - begin) / kSteps;
            double sum = 0.0;
            for (int i = 0; i <= kSteps; ++i) {
                const double r = begin + i * step, pulse = std::cos(kPi * (r - range_m) / 6.0);
                double weight = i % 2 == 1 ? 4.0 : 2.0;
                if (i == 0 || i == kSteps) weight = 1.0;
                sum += weight * pulse * pulse * std::exp(-2.0 * model.alpha() * r) / (r * r);
            }
            return kPi * 0.046 / visibility_m * sum * step / 3.0;
        };
        model.count_stretches(60, mean);
        model.expect_as(make_air_of({.fog_visibility_m = visibility_m}, sensor), ReturnCause::fog);
    }
}

/// Returns a sensor that in clear air detects surfaces with a brightness of at least
/// 0.0025 at any range, like KITTI's HDL-64E. Its intensities have steps of 0.01 and are
/// 0 down to the shortest ranges.
WeatherSensorProperties make_sensor_with_time_control() {
    WeatherSensorProperties sensor = make_sensor_to(80.0);
    sensor.weakest_reflectivity = 0.0025;
    return sensor;
}

double count_false_returns(const Weather& weather) {
    const WeatherRaySimulator air = make_air_of(weather, make_sensor_with_time_control());
    int n = 0;
    for (std::uint64_t seed = 0; seed < kRays; ++seed)
        n += echoes(air, 80.0, seed).strongest.source != ReturnCause::nothing;
    return double(n) / kRays;
}

/// The shares are closed forms in double. Fog: sections of half a pulse have a log-normal
/// power with mean 1, times the mean over the section. Rain: the drops that are bright
/// enough form a Poisson process.
TEST(ThinWeather, ReturnsAsTheClosedForm) {
    for (const auto& [weather, share] : {std::pair{Weather{.fog_visibility_m = 1000.0}, 0.0107714},
                                         {Weather{.fog_visibility_m = 400.0}, 0.1163343},
                                         {Weather{.fog_visibility_m = 150.0}, 0.4817053},
                                         {Weather{.rain_mm_h = 200.0}, 0.0013246}})
        EXPECT_NEAR(count_false_returns(weather) / share, 1.0, 0.1 + 4.0 / std::sqrt(share * kRays))
            << format_weather(weather);
}

/// The share of hidden surfaces must follow a closed form. A surface with intensity 0 in
/// the log has a brightness that is uniformly distributed from 0.0025 to 0.01. If the
/// share A of its light passes the weather, surfaces below 0.0025 / A are hidden.
TEST(ThinWeather, HidesAsManyDarkSurfacesAsTheClosedForm) {
    for (const double rain_mm_h : {5.0, 25.0, 100.0})
        for (const double range_m : {20.0, 50.0}) {
            const Weather weather{.rain_mm_h = rain_mm_h};
            const double left = std::exp(-2.0 * extinction_per_m(weather) * range_m);
            const double expected = std::min(0.0025 * (1.0 / left - 1.0) / (0.01 - 0.0025), 1.0);
            const WeatherRaySimulator air = make_air_of(weather, make_sensor_with_time_control());
            int n_hidden = 0;
            for (std::uint64_t seed = 0; seed < kRays; ++seed)
                n_hidden += !shows_surface(echoes_of(air, surface_at(range_m, 0.0), seed));
            EXPECT_NEAR(double(n_hidden) / kRays, expected, 4.0 * std::sqrt(expected / kRays))
                << rain_mm_h << ' ' << range_m;
        }
}

}  // namespace
}  // namespace relidar
