// SPDX-License-Identifier: Apache-2.0
// Defines how weather effects (rain, snow, fog and others) act on the rays of a scan.
// Each effect is a class in its own file in this folder, and an entry of kWeatherEffects.
// Only the simulate library includes this header.
#pragma once

#include <relidar/diff/forward.hpp>
#include <relidar/simulate/render.hpp>

#include "base/random.hpp"
#include "simulate/channels/scan_motion.hpp"

namespace relidar {

// Range at which the receiver begins to see the laser beam (Hahner et al. 2021).
inline constexpr double kLaserOverlap_m = 1.0;
inline constexpr double kLight_m_s = 299792458.0;

inline double min_air_range_m(const WeatherSensorProperties& sensor) {
    return std::max(kLaserOverlap_m, sensor.min_range_m);
}
inline double pulse_length_m(const WeatherSensorProperties& sensor) { return kLight_m_s * sensor.pulse_s; }
inline double beam_width_m(const WeatherSensorProperties& sensor, double range_m) {
    return sensor.aperture_m + sensor.divergence_rad * range_m;
}
/// Returns the echo of a surface in clear air.
/// @param response converts the intensity to the reflectivity of the surface
inline LidarEcho surface_echo(double range_m, double intensity, const IntensityResponse& response) {
    return {range_m, intensity / response.range_factor(range_m), ReturnCause::surface};
}
/// Returns the received power, relative to that of a surface with reflectivity 1 at 1 m.
inline double power_of(const LidarEcho& echo) { return echo.reflectivity / (echo.range_m * echo.range_m); }

struct WeatherInput {
    const Weather& weather;
    const WeatherSensorProperties& sensor;
    const RenderedScan& scan;  ///< scan in clear air, without weather
    const IntensityResponse& response;
    glm::dvec3 world_offset_m{0.0};  ///< see Log::world_offset_m
    std::function<RenderedRayValues(const WorldRays&)> trace = {};
    std::uint64_t seed = 0;
    /// [rays] true if an object close to the sensor blocks the ray; it then has no
    /// returns from the air. Empty: no ray is blocked.
    std::vector<std::uint8_t> is_blocked = {};
    /// if not set, the channel `velocity` of returns from the air is 0
    const MotionDuringScan* motion = nullptr;
};

struct RayWeatherState {
    std::size_t index = 0;                  ///< index of the ray in its scan
    LidarEcho strongest = {}, second = {};  ///< returns of surfaces in clear air
    double free_m = 0.0;                    ///< distance in metres after which a surface blocks the ray
    double through_water = 1.0;             ///< brightness of the wet ground relative to the dry ground
};

struct EchoCandidate {
    LidarEcho echo;
    double power;
};
using EchoCandidates = std::vector<EchoCandidate>;

class RayWeatherEffect {
public:
    virtual ~RayWeatherEffect() = default;
    /// Changes the return of the surface that a ray hits. Called before the air
    /// attenuates the light.
    virtual void modify_surface(RayWeatherState& /*ray*/) const {}
    /// Adds returns that the effect causes on a ray, for example from raindrops.
    virtual void append_returns(EchoCandidates&, const RayWeatherState&, Random&) const {}
};

struct EchoPair {
    LidarEcho strongest, second;
};

class WeatherRaySimulator {
public:
    /// @throws UsageError for weather that check_weather() rejects
    explicit WeatherRaySimulator(const WeatherInput& input);
    WeatherRaySimulator(const Weather& weather, const WeatherSensorProperties& sensor,
                        std::vector<std::unique_ptr<RayWeatherEffect>> effects);
    /// Computes the strongest and the second return that the sensor measures along a ray.
    /// The second return is the last one, or the second strongest if the last is the
    /// strongest. Leaves out returns below the detection threshold. Without any weather,
    /// these are the returns of the clear air.
    EchoPair echoes_of_ray(RayWeatherState ray, std::uint64_t seed) const;

private:
    const WeatherSensorProperties sensor_;
    const double alpha_;
    std::vector<std::unique_ptr<RayWeatherEffect>> effects_;

    double sample_albedo(const LidarEcho& surface, Random& random) const;
    double append_surface(EchoCandidates& candidates, LidarEcho echo, double brightness, double max_power,
                          Random& random) const;
};

/// Adds a return if its power reaches the detection limit.
/// @param transmission  share of the light that the air does not absorb or scatter
void append_detectable(EchoCandidates& echoes, LidarEcho echo, const WeatherSensorProperties& sensor,
                       double transmission);

/// Adds weather to a scan. If the weather causes a return, the ray gets its range and
/// intensity, the instance -1 and no surface values. The channel `source` has the causes;
/// clear air changes only this channel. The result depends only on seed and time, not on
/// the number of threads.
void add_weather(RenderedScan& scan, const WeatherInput& weather_input);

}  // namespace relidar
