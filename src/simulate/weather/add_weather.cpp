// SPDX-License-Identifier: Apache-2.0
// Adds weather to a scan. Computes for each ray the return that the sensor reports in
// this weather.
#include <bit>

#include "base/parallel.hpp"
#include "simulate/weather/air.hpp"

namespace relidar {
namespace {

// Constant that is mixed into the seed of the weather. The weather is then independent of
// the random numbers for sampled returns.
constexpr std::uint64_t kOfWeather = 0x77656174686572ull;
constexpr const char* kSource = "source";

using Sources = std::vector<std::int32_t>;

/// Returns the channel `source` with all values reset. Adds the channel if the scan does
/// not have it.
ScanChannel& find_source_channel(RenderedScan& scan) {
    const auto has_name = [](const ScanChannel& channel) { return channel.info.name == kSource; };
    const auto found = std::ranges::find_if(scan.channels, has_name);
    const bool is_there = found != scan.channels.end();
    ScanChannel& channel =
        is_there ? *found : scan.channels.emplace_back(ScanChannel{parse_channels(kSource).front(), {}});
    const Sources nothing(scan.image.range_m.size(), std::int32_t(PointSource::nothing));
    channel.values = nothing;
    if (!scan.second_returns.empty()) channel.second = nothing;
    return channel;
}

/// Removes the surface that a ray hit. Sets the instance to -1, and resets all channels
/// that describe surfaces.
void remove_surface(RenderedScan& scan, std::size_t ray) {
    scan.instance[ray] = -1;
    for (ScanChannel& channel : scan.channels)
        if (!channel.info.of_ray)
            std::visit(
                [&]<class T>(std::vector<T>& values) { values[ray] = get_missing_value<T>(channel.info); },
                channel.values);
}

/// Applies the weather to the rays of a scan.
class WeatheredRays {
public:
    WeatheredRays(RenderedScan& scan, const WeatherInput& input)
        : scan_(scan), input_(input), air_(input), channel_(find_source_channel(scan)) {}

    void look(std::size_t index, std::uint64_t seed) {
        const bool has_second = !scan_.second_returns.empty();
        RayInAir ray{.index = index};
        if (is_returned(scan_.image.drop_prob[index], scan_.median_range_m[index]))
            ray.strongest = surface(scan_.median_range_m[index], scan_.image.intensity[index]);
        if (has_second)
            ray.second =
                surface(scan_.second_returns[0].range_m[index], scan_.second_returns[0].intensity[index]);
        RayEchoes seen{ray.strongest, ray.second};
        if (!input_.weather.clear()) {
            const bool is_blind = !input_.blind.empty() && input_.blind[index] != 0;
            ray.free_m = is_blind ? 0.0 : free_m(ray);
            seen = air_.compute_echoes(ray, seed);
            write_echo(index, ray.strongest, seen.strongest);
            if (has_second) write_echo(scan_.second_returns[0], index, seen.second);
        }
        std::get<Sources>(channel_.values)[index] = std::int32_t(seen.strongest.source);
        if (has_second) std::get<Sources>(channel_.second)[index] = std::int32_t(seen.second.source);
    }

private:
    RenderedScan& scan_;
    const WeatherInput& input_;
    const Air air_;
    ScanChannel& channel_;

    Echo surface(float range_m, float intensity) const {
        if (!(range_m > 0.0f)) return {};
        return {double(range_m), double(intensity) / input_.response.at_range(double(range_m)),
                PointSource::surface};
    }
    float to_intensity(const Echo& echo) const {
        return std::min(static_cast<float>(echo.reflectivity * input_.response.at_range(echo.range_m)), 1.0f);
    }
    /// Returns the distance that the light of a ray travels through the air: up to the
    /// first opaque surface, or to the maximum range. The surface stops the light even if
    /// the sensor reports no return.
    double free_m(const RayInAir& ray) const {
        const float median_m = scan_.median_range_m[ray.index];
        const bool is_blocked =
            ray.strongest.source == PointSource::surface || scan_.weight[ray.index] >= 0.5f;
        if (!is_blocked || !(median_m > 0.0f)) return input_.sensor.max_range_m;
        return std::max(double(median_m), ray.second.range_m);
    }
    void write_echo(std::size_t ray, const Echo& original_echo, const Echo& echo) {
        RangeImage& image = scan_.image;
        if (echo.source == PointSource::nothing) {
            if (original_echo.source != PointSource::nothing) image.drop_prob[ray] = 1.0f;
            return;
        }
        image.intensity[ray] = to_intensity(echo);
        if (echo.source == original_echo.source && echo.range_m == original_echo.range_m) return;
        image.drop_prob[ray] = 0.0f;
        image.range_m[ray] = scan_.median_range_m[ray] = scan_.mean_range_m[ray] =
            static_cast<float>(echo.range_m);
        remove_surface(scan_, ray);
    }
    void write_echo(SecondReturn& second, std::size_t ray, const Echo& echo) const {
        second.range_m[ray] = static_cast<float>(echo.range_m);
        second.intensity[ray] = echo.source == PointSource::nothing ? 0.0f : to_intensity(echo);
    }
};

}  // namespace

void add_weather(RenderedScan& scan, const WeatherInput& input) {
    const std::uint64_t of_scan =
        combine_hashes(combine_hashes(input.seed, std::bit_cast<std::uint64_t>(scan.time_s)), kOfWeather);
    WeatheredRays rays(scan, input);
    for_each_block(scan.image.range_m.size(),
                   [&](std::size_t ray) { rays.look(ray, combine_hashes(of_scan, ray)); });
}

}  // namespace relidar
