// SPDX-License-Identifier: Apache-2.0
// Selects the returns that a sensor reports for a ray in weather. All powers are relative
// (see <relidar/simulate/weather.hpp>).
#include "simulate/weather/air.hpp"

#include <cmath>

namespace relidar {
namespace {

/// Returns the second return of a dual-return sensor. Normally, this is the last return.
/// If the strongest return is also the last, the function returns the second strongest.
Echo select_second_return(const Candidates& candidates, const Echo& strongest, double separation_m) {
    Echo last, next;
    double power = 0.0;
    for (const Candidate& candidate : candidates) {
        const double range_m = candidate.echo.range_m;
        if (std::abs(range_m - strongest.range_m) < separation_m) continue;
        if (range_m > std::max(strongest.range_m, last.range_m)) last = candidate.echo;
        if (candidate.power > power) next = candidate.echo, power = candidate.power;
    }
    return last.source == PointSource::nothing ? next : last;
}

std::vector<std::unique_ptr<EffectOnRays>> prepare_effects(const WeatherInput& input) {
    check_weather(input.weather);
    std::vector<std::unique_ptr<EffectOnRays>> effects;
    for (const WeatherEffect* effect : kWeatherEffects) {
        if (!effect->is_in(input.weather)) continue;
        if (auto prepared = effect->prepare(input)) effects.push_back(std::move(prepared));
    }
    return effects;
}

}  // namespace

double WeatherSensor::threshold(double range_m) const {
    return std::max(compute_min_power(), weakest_reflectivity / (range_m * range_m));
}

Air::Air(const WeatherInput& input) : Air(input.weather, input.sensor, prepare_effects(input)) {}

Air::Air(const Weather& weather, const WeatherSensor& sensor,
         std::vector<std::unique_ptr<EffectOnRays>> effects)
    : sensor_(sensor), alpha_(compute_extinction(weather)), effects_(std::move(effects)) {}

/// Returns the reflectivity of a surface. An intensity below one step of the sensor does
/// not determine the reflectivity. Then a random value is drawn, between the weakest
/// detectable reflectivity and one step.
double Air::draw_surface_reflectivity(const Echo& surface, Random& random) const {
    const double step = 2.0 * sensor_.darkest;
    if (surface.reflectivity >= step) return surface.reflectivity;
    return std::lerp(sensor_.threshold(surface.range_m) * surface.range_m * surface.range_m, step,
                     random.uniform());
}

void Air::add_surface(Candidates& candidates, Echo echo, double through_water, Random& random) const {
    if (echo.source == PointSource::nothing) return;
    const double transmission = std::exp(-2.0 * alpha_ * echo.range_m) * through_water;
    const double power =
        draw_surface_reflectivity(echo, random) * transmission / (echo.range_m * echo.range_m);
    echo.reflectivity *= transmission;
    if (power >= sensor_.threshold(echo.range_m)) candidates.push_back({echo, power});
}

void add_echo(Candidates& candidates, Echo echo, const WeatherSensor& sensor, double transmission,
              double darkest) {
    if (echo.source == PointSource::nothing || echo.range_m > sensor.max_range_m) return;
    const double power = std::max(echo.reflectivity, darkest) * transmission / (echo.range_m * echo.range_m);
    echo.reflectivity *= transmission;
    if (power >= sensor.compute_min_power()) candidates.push_back({echo, power});
}

RayEchoes Air::compute_echoes(RayInAir ray, std::uint64_t seed) const {
    Random random(seed);
    Candidates candidates;
    for (const auto& effect : effects_) effect->change_surface(ray);
    add_surface(candidates, ray.strongest, ray.through_water, random);
    add_surface(candidates, ray.second, 1.0, random);
    for (const auto& effect : effects_) effect->add_returns(candidates, ray, random);
    if (candidates.empty()) return {};
    const Echo strongest = std::ranges::max_element(candidates, {}, &Candidate::power)->echo;
    return {strongest, select_second_return(candidates, strongest, sensor_.separation_m)};
}

}  // namespace relidar
