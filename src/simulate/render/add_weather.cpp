// SPDX-License-Identifier: Apache-2.0
// Adds weather to a scan. Computes for each ray which echo the sensor reports,
// considering fog, rain, snow, wet ground, stray light and noise.
#include <algorithm>
#include <bit>

#include <relidar/simulate/render.hpp>

#include "base/parallel.hpp"
#include "base/random.hpp"
#include "simulate/render/scan_renderer.hpp"

namespace relidar {
namespace {

// Constant for the hash, so that the random numbers of the weather are independent of the
// random numbers of a sampled scan.
constexpr std::uint64_t kOfWeather = 0x77656174686572ull;
constexpr const char* kSource = "source";

using Sources = std::vector<std::int32_t>;

/// Returns the channel `source` without values. Adds the channel if the scan does not
/// have it.
ScanChannel& source_channel(RenderedScan& scan) {
    const auto has_name = [](const ScanChannel& channel) { return channel.info.name == kSource; };
    const auto found = std::ranges::find_if(scan.channels, has_name);
    const bool is_there = found != scan.channels.end();
    ScanChannel& channel =
        is_there ? *found : scan.channels.emplace_back(ScanChannel{wanted_channels(kSource).front(), {}});
    const Sources nothing(scan.image.range_m.size(), std::int32_t(PointSource::nothing));
    channel.values = nothing;
    if (!scan.second_returns.empty()) channel.second = nothing;
    return channel;
}

/// Clears the instance of a ray, and the values of the ray in all channels that describe
/// surfaces.
void forget_surface(RenderedScan& scan, std::size_t ray) {
    scan.instance[ray] = -1;
    for (ScanChannel& channel : scan.channels)
        if (!channel.info.of_ray)
            std::visit([&]<class T>(std::vector<T>& values) { values[ray] = nothing_of<T>(channel.info); },
                       channel.values);
}

/// Applies the weather to the rays of a scan.
class WeatheredRays {
public:
    WeatheredRays(RenderedScan& scan, const Air& air, const IntensityResponse& response)
        : scan_(scan), air_(air), response_(response), channel_(source_channel(scan)) {}

    void look(std::size_t ray, const RaysInWeather& special, std::uint64_t seed) {
        const bool has_second = !scan_.second_returns.empty();
        RayEchoes surfaces;
        if (returned(scan_.image.drop_prob[ray], scan_.median_range_m[ray]))
            surfaces.strongest = surface(scan_.median_range_m[ray], scan_.image.intensity[ray]);
        if (has_second)
            surfaces.second =
                surface(scan_.second_returns[0].range_m[ray], scan_.second_returns[0].intensity[ray]);
        RayEchoes seen = surfaces;
        const bool is_blind = !special.blind.empty() && special.blind[ray] != 0;
        if (!special.wet.empty())
            surfaces.strongest.through_water = special.wet[ray].through_water,
            surfaces.mirrored = special.wet[ray].mirrored;
        if (!special.stray.empty() && !is_blind) surfaces.stray = special.stray[ray];
        if (!special.from_sun.empty()) surfaces.from_sun_rad = double(special.from_sun[ray]);
        if (!air_.clear()) {
            seen = air_.look(surfaces, is_blind ? 0.0 : free_m(ray, surfaces), seed);
            put(ray, surfaces.strongest, seen.strongest);
            if (has_second) put(scan_.second_returns[0], ray, seen.second);
        }
        std::get<Sources>(channel_.values)[ray] = std::int32_t(seen.strongest.source);
        if (has_second) std::get<Sources>(channel_.second)[ray] = std::int32_t(seen.second.source);
    }

private:
    RenderedScan& scan_;
    const Air& air_;
    const IntensityResponse& response_;
    ScanChannel& channel_;

    Echo surface(float range_m, float intensity) const {
        if (!(range_m > 0.0f)) return {};
        return {double(range_m), double(intensity) / response_.at_range(double(range_m)),
                PointSource::surface};
    }
    float intensity_of(const Echo& echo) const {
        return std::min(static_cast<float>(echo.reflectivity * response_.at_range(echo.range_m)), 1.0f);
    }
    /// Returns how far the light of a ray travels through air. The path ends at the
    /// surface that the ray hits, even if the sensor reports no return, or at the maximum
    /// range.
    double free_m(std::size_t ray, const RayEchoes& surfaces) const {
        const bool is_blocked =
            surfaces.strongest.source == PointSource::surface || scan_.weight[ray] >= 0.5f;
        if (!is_blocked || !(scan_.median_range_m[ray] > 0.0f)) return air_.max_range_m();
        return std::max(double(scan_.median_range_m[ray]), surfaces.second.range_m);
    }
    void put(std::size_t ray, const Echo& before, const Echo& now) {
        RangeImage& image = scan_.image;
        if (now.source == PointSource::nothing) {
            if (before.source != PointSource::nothing) image.drop_prob[ray] = 1.0f;
            return;
        }
        image.intensity[ray] = intensity_of(now);
        if (now.source == before.source && now.range_m == before.range_m) return;
        image.drop_prob[ray] = 0.0f;
        image.range_m[ray] = scan_.median_range_m[ray] = scan_.mean_range_m[ray] =
            static_cast<float>(now.range_m);
        forget_surface(scan_, ray);
    }
    void put(SecondReturn& second, std::size_t ray, const Echo& now) const {
        second.range_m[ray] = static_cast<float>(now.range_m);
        second.intensity[ray] = now.source == PointSource::nothing ? 0.0f : intensity_of(now);
    }
};

}  // namespace

/// Returns a model of the air in front of a sensor.
/// @param rays rays of the sensor, which define the beam divergence
Air ScanRenderer::Impl::air_before(const SensorChoice& sensor, const RayTable& rays) const {
    WeatherSensor takes;
    const double step = scatter[std::size_t(sensor.lidar)].step, divergence_rad = rays.largest_divergence();
    if (config.sensor.divergence_mrad > 0.0) takes.divergence_rad = 1e-3 * config.sensor.divergence_mrad;
    else if (divergence_rad > 0.0) takes.divergence_rad = divergence_rad;
    if (step > 0.0) takes.darkest = 0.5 * step;
    // An intensity that the sensor reports as 0 lies between 0 and half a step. This is
    // the middle of the interval.
    takes.weakest_reflectivity = 0.5 * takes.darkest;
    takes.separation_m = config.sensor.return_separation_m;
    takes.min_range_m = limits_of(sensor).min_m, takes.max_range_m = limits_of(sensor).max_m;
    return {weather, takes};
}

void add_weather(RenderedScan& scan, const Air& air, const IntensityResponse& response,
                 const RaysInWeather& special, std::uint64_t seed) {
    const std::uint64_t of_scan = hash64(hash64(seed, std::bit_cast<std::uint64_t>(scan.time_s)), kOfWeather);
    WeatheredRays rays(scan, air, response);
    for_each_block(scan.image.range_m.size(),
                   [&](std::size_t ray) { rays.look(ray, special, hash64(of_scan, ray)); });
}

}  // namespace relidar
