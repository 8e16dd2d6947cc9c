// SPDX-License-Identifier: Apache-2.0
// Creates air for tests of single rays.
#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "simulate/weather/air.hpp"

namespace relidar::test {

/// Weather effect that adds the same echo to every ray and makes every surface darker.
class GivenEcho : public EffectOnRays {
public:
    GivenEcho(const WeatherSensor& sensor, const Echo& echo, double transmission, double through_water)
        : sensor_(sensor), echo_(echo), transmission_(transmission), through_water_(through_water) {}
    void change_surface(RayInAir& ray) const override { ray.through_water = through_water_; }
    void add_returns(Candidates& candidates, const RayInAir&, Random&) const override {
        add_echo(candidates, echo_, sensor_, transmission_);
    }

private:
    const WeatherSensor sensor_;
    const Echo echo_;
    const double transmission_, through_water_;
};

/// Returns clear air with an additional effect that adds an echo.
inline Air make_air_with(const WeatherSensor& sensor, const Echo& echo, double transmission = 1.0,
                         double through_water = 1.0) {
    std::vector<std::unique_ptr<EffectOnRays>> effects;
    effects.push_back(std::make_unique<GivenEcho>(sensor, echo, transmission, through_water));
    return {{}, sensor, std::move(effects)};
}

/// Returns the air of a scan that has a single ray along the x axis.
/// @param hides_sun alpha of the surfaces between the sensor and the sun
inline Air make_air_of(const Weather& weather, const WeatherSensor& sensor = {}, float hides_sun = 0.0f) {
    RenderedScan scan;
    scan.image.rows = scan.image.columns = 1;
    scan.image.origin = {glm::vec3(0.0f)}, scan.image.direction = {glm::vec3(1.0f, 0.0f, 0.0f)};
    scan.image.range_m = scan.median_range_m = scan.image.intensity = {0.0f};
    scan.image.drop_prob = {1.0f}, scan.time_offset_s = {0.0f}, scan.ring = {0}, scan.instance = {-1};
    const IntensityResponse response;
    return Air(WeatherInput{.weather = weather,
                            .sensor = sensor,
                            .scan = scan,
                            .response = response,
                            .trace = [hides_sun](const WorldRays&) {
                                Rendering rendering;
                                rendering.weight = {hides_sun};
                                return rendering;
                            }});
}

/// Returns a ray with the returns of surfaces.
inline RayInAir make_ray_to(const Echo& strongest, double free_m, const Echo& second = {}) {
    return {.strongest = strongest, .second = second, .free_m = free_m};
}

}  // namespace relidar::test
