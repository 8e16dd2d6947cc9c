// SPDX-License-Identifier: Apache-2.0
// Simulates returns from rain and snow. The particle density is N(D) = N0 exp(-Lambda D)
// per cubic metre and millimetre, where D is the diameter of the melted particle. The
// detectable particles form a Poisson process along the beam, as in LISA (Kilic et al.
// 2021) and Hahner et al. (CVPR 2022):
//   power(D, R) = rho (D / B(R))^2 exp(-2 alpha R) / R^2,  B(R): width of the beam
// Particles remove twice the light that their cross section covers (Q_ext = 2), because
// they are much larger than the wavelength.

#include "simulate/weather/air.hpp"

namespace relidar {
namespace {

constexpr double kParticleStep_m = 0.05;  // Range step in metres of the table of particle counts.

struct ParticleDistribution {
    ReturnCause source;
    double per_m3_mm;     // N0
    double slope_per_mm;  // Lambda
    double widening;      // ratio of the particle's diameter to its diameter after melting
    double reflectivity;
    double (*fall_speed)(double melted_mm);
};

/// Returns the sizes of raindrops (Marshall and Palmer 1948). A drop reflects as water,
/// ((n - 1) / (n + 1))^2. Speed: Atlas, Srivastava and Sekhon 1973.
ParticleDistribution rain_drops(const Weather& weather) {
    return {ReturnCause::rain, 8000.0, 4.1 * std::pow(weather.rain_mm_h, -0.21), 1.0, 0.02, [](double mm) {
                return std::max(9.65 - 10.3 * std::exp(-0.6 * mm), 0.0);
            }};
}

/// Returns the size distribution of snowflakes by the diameter of the melted flake (Gunn
/// and Marshall 1958). The density is a tenth of water's, so a flake is wider by the cube
/// root of 10. All flakes fall at 1 m/s (assumption).
ParticleDistribution snow_flakes(const Weather& weather) {
    return {ReturnCause::snow,
            3.8e3 * std::pow(weather.snow_mm_h, -0.87),
            2.55 * std::pow(weather.snow_mm_h, -0.48),
            std::cbrt(10.0),
            0.25,
            [](double) { return 1.0; }};
}

template <ParticleDistribution (*particles_of)(const Weather&)>
double particle_extinction(const Weather& weather) {
    const ParticleDistribution p = particles_of(weather);
    return kPi * p.per_m3_mm * 1e-6 * p.widening * p.widening / std::pow(p.slope_per_mm, 3);
}

class PrecipitationEffect : public RayWeatherEffect {
public:
    /// Tabulates the expected number of detectable particles (trapezoidal rule).
    PrecipitationEffect(const WeatherInput& input, const ParticleDistribution& particles)
        : sensor_(input.sensor), alpha_(extinction_per_m(input.weather)), falling_(particles) {
        double expected = 0.0, before = 0.0;
        for (double r = min_air_range_m(sensor_); r <= sensor_.max_range_m + kParticleStep_m;
             r += kParticleStep_m) {
            const double area = 0.25 * kPi * beam_width_m(sensor_, r) * beam_width_m(sensor_, r),
                         density = area * falling_.per_m3_mm / falling_.slope_per_mm *
                                   std::exp(-falling_.slope_per_mm * min_diameter_mm(r));
            if (!expected_.empty()) expected += 0.5 * (before + density) * kParticleStep_m;
            before = density;
            expected_.push_back(expected);
        }
    }

    /// Draws particles at random counts of the table, which makes them a Poisson process.
    /// The size above the smallest detectable size is exponentially distributed.
    void append_returns(EchoCandidates& echoes, const RayWeatherState& ray, Random& random) const override {
        if (expected_.empty()) return;
        const auto waiting = [&random] { return -std::log(1.0 - random.sample_uniform()); };
        for (double n = waiting(); n < expected_.back(); n += waiting()) {
            const auto next = std::ranges::upper_bound(expected_, n);
            const double part = (n - *(next - 1)) / (*next - *(next - 1));
            const double range_m =
                min_air_range_m(sensor_) + (double(next - expected_.begin()) - 1.0 + part) * kParticleStep_m;
            if (range_m >= std::min(ray.free_m, sensor_.max_range_m)) return;
            const double melted_mm = min_diameter_mm(range_m) + waiting() / falling_.slope_per_mm,
                         wide_m = 1e-3 * falling_.widening * melted_mm;
            const double share = std::min(wide_m / beam_width_m(sensor_, range_m), 1.0),
                         reflectivity =
                             falling_.reflectivity * share * share * std::exp(-2.0 * alpha_ * range_m);
            echoes.push_back({{range_m, reflectivity, falling_.source, falling_.fall_speed(melted_mm)},
                              reflectivity / (range_m * range_m)});
        }
    }

private:
    const WeatherSensorProperties sensor_;
    const double alpha_;
    const ParticleDistribution falling_;
    // [k] expected particles that the sensor can detect from the minimum range to k *
    // kParticleStep_m beyond it
    std::vector<double> expected_;

    /// Returns the diameter of the smallest particle that the sensor detects at a range;
    /// for snow, of the melted flake. Infinity if even a particle as wide as the beam is
    /// too dark.
    double min_diameter_mm(double range_m) const {
        const double share = sensor_.min_power_at(range_m) * range_m * range_m *
                             std::exp(2.0 * alpha_ * range_m) / falling_.reflectivity;
        if (share > 1.0) return std::numeric_limits<double>::infinity();
        return 1e3 * beam_width_m(sensor_, range_m) * std::sqrt(share) / falling_.widening;
    }
};

template <ParticleDistribution (*particles_of)(const Weather&)>
std::unique_ptr<RayWeatherEffect> make_particles(const WeatherInput& input) {
    return std::make_unique<PrecipitationEffect>(input, particles_of(input.weather));
}

constexpr WeatherParameter kRainNumbers[] = {
    {[](Weather& weather) -> double& { return weather.rain_mm_h; }, 0.0, 500.0}};
constexpr WeatherParameter kSnowNumbers[] = {
    {[](Weather& weather) -> double& { return weather.snow_mm_h; }, 0.0, 100.0}};

}  // namespace

const WeatherEffectEntry kRainEffect{.name = "rain",
                                     .form = "rain=MM_PER_H",
                                     .expected = "a rate of 0 to 500 mm/h",
                                     .examples = "rain=5 rain=25",
                                     .numbers = kRainNumbers,
                                     .extinction = particle_extinction<rain_drops>,
                                     .prepare = make_particles<rain_drops>};
const WeatherEffectEntry kSnowEffect{.name = "snow",
                                     .form = "snow=MM_PER_H",
                                     .meaning = "of melted snow",
                                     .expected = "a snowfall rate of 0 to 100 mm/h, measured as melted water",
                                     .examples = "snow=1 snow=4",
                                     .numbers = kSnowNumbers,
                                     .extinction = particle_extinction<snow_flakes>,
                                     .prepare = make_particles<snow_flakes>};

}  // namespace relidar
