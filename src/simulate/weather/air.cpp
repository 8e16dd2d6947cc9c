// SPDX-License-Identifier: Apache-2.0
// Selects the returns that a sensor reports for a ray in weather. All powers are relative
// (see <relidar/simulate/weather.hpp>).
#include "simulate/weather/air.hpp"

#include "simulate/render/footprint.hpp"

namespace relidar {
namespace {

// A surface below the detection limit has a random brightness up to this multiple of the
// limit. The value is an assumption.
constexpr double kBrightestUnknownSurface = 4.0;

/// Compares surfaces by their reflectivities, as in clear air, and other returns by their
/// powers.
bool is_bright_enough(const EchoCandidate& candidate, const EchoCandidate& strongest) {
    const auto& [range_m, reflectivity, source, fall_mps, away_mps] = candidate.echo;
    if (source == ReturnCause::surface && strongest.echo.source == ReturnCause::surface)
        return reflectivity >= kSecondReturnShare * strongest.echo.reflectivity;
    return reflectivity / (range_m * range_m) >= kSecondReturnShare * strongest.power;
}

/// Returns the second return of a dual-return sensor. This is the last return, or the
/// second strongest if the strongest return is also the last.
LidarEcho select_second(const EchoCandidates& echoes, const EchoCandidate& strongest, double separation_m) {
    LidarEcho last, next;
    double power = 0.0;
    for (const EchoCandidate& candidate : echoes) {
        const double range_m = candidate.echo.range_m, strongest_m = strongest.echo.range_m;
        if (std::abs(range_m - strongest_m) < separation_m) continue;
        if (!is_bright_enough(candidate, strongest)) continue;
        if (range_m > std::max(strongest_m, last.range_m)) last = candidate.echo;
        if (candidate.power > power) {
            next = candidate.echo;
            power = candidate.power;
        }
    }
    return last.source == ReturnCause::nothing ? next : last;
}

std::vector<std::unique_ptr<RayWeatherEffect>> make_effects(const WeatherInput& input) {
    check_weather(input.weather);
    std::vector<std::unique_ptr<RayWeatherEffect>> effects;
    for (const WeatherEffectEntry* effect : kWeatherEffects) {
        if (!effect->is_active(input.weather)) continue;
        if (auto prepared = effect->prepare(input)) effects.push_back(std::move(prepared));
    }
    return effects;
}

}  // namespace

double WeatherSensorProperties::min_power_at(double range_m) const {
    return std::max({floor_power(), min_specified_power, weakest_reflectivity / (range_m * range_m)});
}

WeatherRaySimulator::WeatherRaySimulator(const WeatherInput& input)
    : WeatherRaySimulator(input.weather, input.sensor, make_effects(input)) {}

WeatherRaySimulator::WeatherRaySimulator(const Weather& weather, const WeatherSensorProperties& sensor,
                                         std::vector<std::unique_ptr<RayWeatherEffect>> effects)
    : sensor_(sensor), alpha_(extinction_per_m(weather)), effects_(std::move(effects)) {}

/// Returns the reflectivity of a surface. If the log has a lower intensity than the
/// sensor could detect, it is not exact: returns a random value above the limit.
double WeatherRaySimulator::sample_albedo(const LidarEcho& surface, Random& random) const {
    const double lowest = sensor_.min_power_at(surface.range_m) * surface.range_m * surface.range_m;
    if (surface.reflectivity >= lowest) return surface.reflectivity;
    return std::lerp(lowest, kBrightestUnknownSurface * lowest, random.sample_uniform());
}

/// Adds the return of a surface if it is still detected. Its light passes the air twice.
/// @param brightness brightness of the wet ground relative to the dry ground
void WeatherRaySimulator::append_surface(EchoCandidates& echoes, LidarEcho echo, double brightness,
                                         Random& random) const {
    if (echo.source == ReturnCause::nothing) return;
    const double transmission = std::exp(-2.0 * alpha_ * echo.range_m) * brightness;
    const double power = sample_albedo(echo, random) * transmission / (echo.range_m * echo.range_m);
    echo.reflectivity *= transmission;
    if (power >= sensor_.min_power_at(echo.range_m)) echoes.push_back({echo, power});
}

void append_detectable(EchoCandidates& echoes, LidarEcho echo, const WeatherSensorProperties& sensor,
                       double transmission) {
    if (echo.source == ReturnCause::nothing || echo.range_m > sensor.max_range_m) return;
    echo.reflectivity *= transmission;
    const double power = echo.reflectivity / (echo.range_m * echo.range_m);
    // Stray light around a reflector has its own limit.
    const double weakest = echo.source == ReturnCause::blooming
                               ? std::max(sensor.floor_power(), sensor.min_stray_power)
                               : sensor.min_power_at(echo.range_m);
    if (power >= weakest) echoes.push_back({echo, power});
}

EchoPair WeatherRaySimulator::echoes_of_ray(RayWeatherState ray, std::uint64_t seed) const {
    Random random(seed);
    EchoCandidates candidates;
    for (const auto& effect : effects_) effect->modify_surface(ray);
    append_surface(candidates, ray.strongest, ray.through_water, random);
    // 1.0: not darkened by water
    append_surface(candidates, ray.second, 1.0, random);
    for (const auto& effect : effects_) effect->append_returns(candidates, ray, random);
    if (candidates.empty()) return {};
    const EchoCandidate strongest = *std::ranges::max_element(candidates, {}, &EchoCandidate::power);
    return {strongest.echo, select_second(candidates, strongest, sensor_.separation_m)};
}

}  // namespace relidar
