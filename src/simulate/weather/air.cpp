// SPDX-License-Identifier: Apache-2.0
// Selects the returns that a sensor reports for a ray in weather. All powers are relative
// (see <relidar/simulate/weather.hpp>).
#include "simulate/weather/air.hpp"

#include <bit>

#include "base/parallel.hpp"
#include "simulate/channels/channel_pairs.hpp"

namespace relidar {
namespace {

// A surface below the detection limit has a random brightness up to this multiple of the
// limit. The value is an assumption.
constexpr double kBrightestUnknownSurface = 4.0;

// Minimum power of a second return, relative to the strongest return, if one of both is
// of the air. The value is an assumption.
constexpr double kSecondReturnShare = 0.1;

constexpr double kUnlimited = std::numeric_limits<double>::infinity();

/// Returns true if a candidate can be the second return. If both returns are of surfaces,
/// the sensor has separated them in clear air, and the power that it detects is enough.
/// @param separation_m minimum distance from the strongest return
bool can_be_second(const EchoCandidate& candidate, const EchoCandidate& strongest, double separation_m) {
    const double distance_m = std::abs(candidate.echo.range_m - strongest.echo.range_m);
    if (candidate.echo.source == ReturnCause::surface && strongest.echo.source == ReturnCause::surface)
        return distance_m > 0.0;
    return distance_m >= separation_m && power_of(candidate.echo) >= kSecondReturnShare * strongest.power;
}

/// Returns the second return of a dual-return sensor. This is the last return, or the
/// second strongest if the strongest return is also the last.
/// @param separation_m minimum distance from the strongest return
LidarEcho select_second(EchoCandidates echoes, const EchoCandidate& strongest, double separation_m) {
    const double strongest_m = strongest.echo.range_m;
    std::erase_if(echoes, [&](const EchoCandidate& candidate) {
        return !can_be_second(candidate, strongest, separation_m);
    });
    if (echoes.empty()) return {};
    const auto range_of = [](const EchoCandidate& candidate) { return candidate.echo.range_m; };
    const LidarEcho& last = std::ranges::max_element(echoes, {}, range_of)->echo;
    return last.range_m > strongest_m ? last
                                      : std::ranges::max_element(echoes, {}, &EchoCandidate::power)->echo;
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

// Makes the random numbers of weather and sampled returns independent.
constexpr std::uint64_t kOfWeather = 0x77656174686572ull;
constexpr const char* kSourceChannel = "source";

using ReturnCauses = std::vector<std::int32_t>;

/// Returns the channel "source", which stores the cause of each return, and sets all
/// causes to `nothing`. Adds the channel if the scan does not have it.
ScanChannel& prepare_causes(RenderedScan& scan) {
    if (!find_channel(scan, kSourceChannel))
        scan.channels.push_back({parse_channels(kSourceChannel).front(), {}});
    ScanChannel& channel = *find_channel(scan, kSourceChannel);
    const ReturnCauses nothing(scan.image.range_m.size(), std::int32_t(ReturnCause::nothing));
    channel.values = nothing;
    if (!scan.second_returns.empty()) channel.second = nothing;
    return channel;
}

/// Returns the channel "velocity" of a scan with a value for each second return, or null
/// if the scan does not have this channel.
ScanChannel* prepare_velocity(RenderedScan& scan) {
    ScanChannel* channel = find_channel(scan, "velocity");
    if (channel && !scan.second_returns.empty())
        channel->second = std::vector<float>(scan.instance.size(), 0.0f);
    return channel;
}

/// Removes the surface of a ray: its instance and all channels that describe surfaces.
void clear_surface(RenderedScan& scan, std::size_t ray) {
    scan.instance[ray] = -1;
    for (ScanChannel& channel : scan.channels)
        if (!channel.info.of_ray)
            std::visit([&]<class T>(std::vector<T>& values) { values[ray] = empty_value<T>(channel.info); },
                       channel.values);
}

class ScanWeatherApplier {
public:
    ScanWeatherApplier(RenderedScan& scan, const WeatherInput& input)
        : scan_(scan),
          input_(input),
          air_(input),
          channel_(prepare_causes(scan)),
          velocity_(input.motion && !input.weather.is_clear() ? prepare_velocity(scan) : nullptr) {}

    /// Computes the returns of a ray in the weather. In clear air, sets only the causes.
    void apply_to_ray(std::size_t ray_index, std::uint64_t seed) {
        const bool has_second = !scan_.second_returns.empty();
        RayWeatherState ray{.index = ray_index};
        if (is_ray_returned(scan_.image.drop_prob[ray_index], scan_.median_range_m[ray_index]))
            ray.strongest =
                surface_echo_of(scan_.median_range_m[ray_index], scan_.image.intensity[ray_index]);
        if (has_second)
            ray.second = surface_echo_of(scan_.second_returns[0].range_m[ray_index],
                                         scan_.second_returns[0].intensity[ray_index]);
        EchoPair echoes{ray.strongest, ray.second};
        if (!input_.weather.is_clear()) {
            const bool is_blocked = !input_.is_blocked.empty() && input_.is_blocked[ray_index] != 0;
            ray.free_m = is_blocked ? 0.0 : free_path_m(ray);
            echoes = air_.echoes_of_ray(ray, seed);
            write_strongest(ray_index, ray.strongest, echoes.strongest);
            if (has_second) write_second(scan_.second_returns[0], ray_index, echoes.second);
            if (velocity_) {
                set_air_velocity(velocity_->values, ray_index, echoes.strongest);
                if (has_second) set_air_velocity(velocity_->second, ray_index, echoes.second);
            }
        }
        std::get<ReturnCauses>(channel_.values)[ray_index] = std::int32_t(echoes.strongest.source);
        if (has_second)
            std::get<ReturnCauses>(channel_.second)[ray_index] = std::int32_t(echoes.second.source);
    }

private:
    RenderedScan& scan_;
    const WeatherInput& input_;
    const WeatherRaySimulator air_;
    ScanChannel& channel_;
    ScanChannel* const velocity_;  // null if the scan has no channel "velocity"

    LidarEcho surface_echo_of(float range_m, float intensity) const {
        if (!(range_m > 0.0f)) return {};
        return surface_echo(range_m, intensity, input_.response);
    }
    float reported_intensity(const LidarEcho& echo) const {
        return std::min(static_cast<float>(echo.reflectivity * input_.response.range_factor(echo.range_m)),
                        1.0f);
    }
    /// Returns the distance that light travels through the air: to the first opaque
    /// surface, with or without a return, or to the maximum range.
    double free_path_m(const RayWeatherState& ray) const {
        const float median_m = scan_.median_range_m[ray.index];
        const bool is_blocked =
            ray.strongest.source == ReturnCause::surface || scan_.weight[ray.index] >= 0.5f;
        if (!is_blocked || !(median_m > 0.0f)) return input_.sensor.max_range_m;
        return std::max(double(median_m), ray.second.range_m);
    }
    /// Writes the strongest return. Keeps the surface values if the return is still the
    /// surface, otherwise removes them.
    void write_strongest(std::size_t ray_index, const LidarEcho& before, const LidarEcho& after) {
        RangeImage& image = scan_.image;
        if (after.source == ReturnCause::nothing) {
            if (before.source != ReturnCause::nothing) image.drop_prob[ray_index] = 1.0f;
            return;
        }
        image.intensity[ray_index] = reported_intensity(after);
        if (after.source == before.source && after.range_m == before.range_m) return;
        image.drop_prob[ray_index] = 0.0f;
        image.range_m[ray_index] = scan_.median_range_m[ray_index] = scan_.mean_range_m[ray_index] =
            static_cast<float>(after.range_m);
        clear_surface(scan_, ray_index);
    }
    /// Sets the velocity of fog, rain, snow and mirrored objects. Sunlight and stray
    /// light have no object, so their velocity stays 0.
    void set_air_velocity(ChannelValues& values, std::size_t ray_index, const LidarEcho& echo) const {
        if (echo.source < ReturnCause::fog || echo.source > ReturnCause::mirror) return;
        const RayMotion ray = input_.motion->motion_of_ray(scan_, ray_index);
        std::get<std::vector<float>>(values)[ray_index] =
            float(echo.away_mps - ray.sensor_away_mps - echo.fall_mps * ray.direction.z);
    }
    void write_second(AdditionalReturns& second, std::size_t ray_index, const LidarEcho& echo) const {
        second.range_m[ray_index] = static_cast<float>(echo.range_m);
        second.intensity[ray_index] = echo.source == ReturnCause::nothing ? 0.0f : reported_intensity(echo);
    }
};

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
/// @param max_power upper limit of the power in clear air that is compared with other
/// returns. A power above the limit counts as much below it, because any weather would
/// decide between equal powers.
/// @return the power in clear air; infinite if the ray hits no surface
double WeatherRaySimulator::append_surface(EchoCandidates& echoes, LidarEcho echo, double brightness,
                                           double max_power, Random& random) const {
    if (echo.source == ReturnCause::nothing) return kUnlimited;
    const double transmission = std::exp(-2.0 * alpha_ * echo.range_m) * brightness;
    const double power = sample_albedo(echo, random) / (echo.range_m * echo.range_m);
    echo.reflectivity *= transmission;
    const double compared = power > max_power ? max_power * max_power / power : power;
    if (power * transmission >= sensor_.min_power_at(echo.range_m))
        echoes.push_back({echo, compared * transmission});
    return power;
}

void append_detectable(EchoCandidates& echoes, LidarEcho echo, const WeatherSensorProperties& sensor,
                       double transmission) {
    if (echo.source == ReturnCause::nothing || echo.range_m > sensor.max_range_m) return;
    echo.reflectivity *= transmission;
    const double power = power_of(echo);
    // Stray light around a reflector has its own limit.
    const double weakest = echo.source == ReturnCause::blooming
                               ? std::max(sensor.floor_power(), sensor.min_stray_power)
                               : sensor.min_power_at(echo.range_m);
    if (power >= weakest) echoes.push_back({echo, power});
}

EchoPair WeatherRaySimulator::echoes_of_ray(RayWeatherState ray, std::uint64_t seed) const {
    Random random(seed);
    EchoCandidates candidates;
    // All effects draw from one generator, so their order determines the result.
    for (const auto& effect : effects_) effect->modify_surface(ray);
    constexpr double kDry = 1.0;  // the second surface is not darkened by water
    const double power = append_surface(candidates, ray.strongest, ray.through_water, kUnlimited, random);
    // In clear air, the second surface is the weaker one. Noise of the intensities and
    // unknown brightnesses must not change that.
    append_surface(candidates, ray.second, kDry, power, random);
    for (const auto& effect : effects_) effect->append_returns(candidates, ray, random);
    if (candidates.empty()) return {};
    const EchoCandidate strongest = *std::ranges::max_element(candidates, {}, &EchoCandidate::power);
    return {strongest.echo, select_second(std::move(candidates), strongest, sensor_.separation_m)};
}

void add_weather(RenderedScan& scan, const WeatherInput& input) {
    const std::uint64_t of_scan =
        hash_pair(hash_pair(input.seed, std::bit_cast<std::uint64_t>(scan.time_s)), kOfWeather);
    ScanWeatherApplier rays(scan, input);
    parallel_blocks(scan.image.range_m.size(),
                    [&](std::size_t ray) { rays.apply_to_ray(ray, hash_pair(of_scan, ray)); });
}

}  // namespace relidar
