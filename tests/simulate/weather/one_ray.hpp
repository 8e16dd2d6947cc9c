// SPDX-License-Identifier: Apache-2.0
// Creates air for tests of single rays.
#pragma once

#include "simulate/weather/air.hpp"

namespace relidar::test {

/// Weather effect that adds the same echo to every ray and makes every surface darker.
class GivenEcho : public RayWeatherEffect {
public:
    GivenEcho(const WeatherSensorProperties& sensor, const LidarEcho& echo, double transmission,
              double through_water)
        : sensor_(sensor), echo_(echo), transmission_(transmission), through_water_(through_water) {}
    void modify_surface(RayWeatherState& ray) const override { ray.through_water = through_water_; }
    void append_returns(EchoCandidates& candidates, const RayWeatherState&, Random&) const override {
        append_detectable(candidates, echo_, sensor_, transmission_);
    }

private:
    const WeatherSensorProperties sensor_;
    const LidarEcho echo_;
    const double transmission_, through_water_;
};

inline WeatherRaySimulator make_air_with(const WeatherSensorProperties& sensor, const LidarEcho& echo,
                                         double transmission = 1.0, double through_water = 1.0) {
    std::vector<std::unique_ptr<RayWeatherEffect>> effects;
    effects.push_back(std::make_unique<GivenEcho>(sensor, echo, transmission, through_water));
    return {{}, sensor, std::move(effects)};
}

/// Returns the air of a scan that has a single ray along the x axis.
/// @param hides_sun alpha of the surfaces between the sensor and the sun
inline WeatherRaySimulator make_air_of(const Weather& weather, const WeatherSensorProperties& sensor = {},
                                       float hides_sun = 0.0f) {
    RenderedScan scan;
    scan.image.rows = scan.image.columns = 1;
    scan.image.origin = {glm::vec3(0.0f)};
    scan.image.direction = {glm::vec3(1.0f, 0.0f, 0.0f)};
    scan.image.range_m = scan.median_range_m = scan.image.intensity = {0.0f};
    scan.image.drop_prob = {1.0f};
    scan.time_offset_s = {0.0f};
    scan.ring = {0};
    scan.instance = {-1};
    const IntensityResponse response;
    return WeatherRaySimulator(WeatherInput{.weather = weather,
                                            .sensor = sensor,
                                            .scan = scan,
                                            .response = response,
                                            .trace = [hides_sun](const WorldRays&) {
                                                RenderedRayValues rendering;
                                                rendering.weight = {hides_sun};
                                                return rendering;
                                            }});
}

inline WeatherSensorProperties make_sensor_to(double max_range_m) {
    return {.max_range_m = max_range_m, .darkest = 0.005};
}
inline LidarEcho surface_at(double range_m, double reflectivity) {
    return {range_m, reflectivity, ReturnCause::surface};
}
inline EchoPair echoes(const WeatherRaySimulator& air, double free_m, std::uint64_t seed,
                       const LidarEcho& strongest = {}, const LidarEcho& second = {}) {
    return air.echoes_of_ray({.strongest = strongest, .second = second, .free_m = free_m}, seed);
}
inline EchoPair echoes_of(const WeatherRaySimulator& air, const LidarEcho& surface, std::uint64_t seed) {
    return echoes(air, surface.range_m, seed, surface);
}

/// Returns chi^2 of counts against expected counts, as a standard normal deviate (Wilson
/// and Hilferty 1931). By chance, it is outside -4 to 4 in 1 of 16,000 cases.
inline double compute_chi2_deviate(const std::vector<double>& counts, const std::vector<double>& expected) {
    double chi2 = 0.0;
    for (std::size_t k = 0; k < counts.size(); ++k)
        chi2 += (counts[k] - expected[k]) * (counts[k] - expected[k]) / expected[k];
    const double f = double(counts.size()) - 1.0, spread = 2.0 / (9.0 * f);
    return (std::cbrt(chi2 / f) - (1.0 - spread)) / std::sqrt(spread);
}

}  // namespace relidar::test
