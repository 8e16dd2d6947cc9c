// SPDX-License-Identifier: Apache-2.0
// Defines how weather effects (rain, snow, fog and others) act on the rays of a scan.
// Each effect is a class in its own file in this folder, and an entry of kWeatherEffects.
// Only the simulate library includes this header.
#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include <relidar/diff/forward.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/weather.hpp>

#include "base/random.hpp"
#include "simulate/render/scan_motion.hpp"

namespace relidar {

// Range in metres at which the receiver begins to see the laser beam. Nearer air returns
// no light to the receiver (Hahner et al. 2021).
inline constexpr double kOverlap_m = 1.0;
inline constexpr double kLight_m_s = 299792458.0;

/// Returns the minimum range in metres of returns that are caused by the air, for example
/// by fog or rain.
inline double compute_min_air_return_range_m(const WeatherSensorProperties& sensor) {
    return std::max(kOverlap_m, sensor.min_range_m);
}
inline double compute_pulse_length_m(const WeatherSensorProperties& sensor) {
    return kLight_m_s * sensor.pulse_s;
}
/// Returns the diameter of the laser beam at a given range, in metres.
inline double compute_beam_diameter_m(const WeatherSensorProperties& sensor, double range_m) {
    return sensor.aperture_m + sensor.divergence_rad * range_m;
}

/// Input of all weather effects: the weather, a scan, its sensor, and the scene around
/// it.
struct WeatherInput {
    const Weather& weather;
    const WeatherSensorProperties& sensor;
    const RenderedScan& scan;  ///< scan in clear air, without weather
    /// model of how the reported intensity of a surface depends on its range
    const IntensityResponse& response;
    glm::dvec3 world_offset_m{0.0};  ///< see LidarSequence::world_offset_m
    /// Traces additional rays through the scene at the time of the scan.
    std::function<RenderedRayValues(const WorldRays&)> trace = {};
    std::uint64_t seed = 0;
    /// [rays] true if an object close to the sensor blocks the ray. A blocked ray has no
    /// returns from fog, rain, snow or noise. If the list is empty, no ray is blocked.
    std::vector<std::uint8_t> blind = {};
    /// Motion of the sensor and of the objects during the scan. If it is not set, the
    /// channel `velocity` of returns from the air is 0.
    const MotionDuringScan* motion = nullptr;
};

/// A ray of the scan, and the values that weather effects use and change.
struct RayWeatherState {
    std::size_t index = 0;                  ///< index of the ray in its scan
    LidarEcho strongest = {}, second = {};  ///< returns of surfaces in clear air
    double free_m = 0.0;                    ///< distance in metres after which a surface blocks the ray
    double through_water = 1.0;             ///< brightness of the wet ground relative to the dry ground
};

/// A possible return of a ray that is bright enough for the sensor.
struct EchoCandidate {
    LidarEcho echo;
    double power;
};
using EchoCandidates = std::vector<EchoCandidate>;

/// A weather effect, such as rain, for the rays of one scan.
class RayWeatherEffect {
public:
    virtual ~RayWeatherEffect() = default;
    /// Changes the return of the surface that a ray hits. The simulation calls this
    /// function before the air attenuates the light.
    virtual void modify_surface_return(RayWeatherState& /*ray*/) const {}
    /// Adds the possible returns that the effect causes on a ray, for example from
    /// raindrops.
    virtual void append_effect_returns(EchoCandidates& /*candidates*/, const RayWeatherState& /*ray*/,
                                       Random& /*random*/) const {}
};

/// The strongest return of a ray, and the second return if the sensor reports two
/// returns.
struct EchoPair {
    LidarEcho strongest, second;
};

/// Simulates what a sensor measures along a ray in weather. The air attenuates the return
/// of the surface, and weather effects add more returns.
class WeatherRaySimulator {
public:
    /// Creates the weather effects for the rays of a scan.
    /// @throws UsageError for weather that require_valid_weather() rejects
    explicit WeatherRaySimulator(const WeatherInput& input);
    /// Creates the simulation with a given list of weather effects.
    WeatherRaySimulator(const Weather& weather, const WeatherSensorProperties& sensor,
                        std::vector<std::unique_ptr<RayWeatherEffect>> effects);
    /// Computes the strongest and the second return that the sensor measures along a ray.
    /// The second return is the last one. If the last return is also the strongest, the
    /// second strongest is used. Both are at least WeatherSensorProperties::separation_m
    /// apart. The second return needs a tenth of the light of the strongest. Leaves out
    /// returns below the detection threshold.
    EchoPair compute_echoes_in_weather(RayWeatherState ray, std::uint64_t seed) const;

private:
    const WeatherSensorProperties sensor_;
    const double alpha_;
    std::vector<std::unique_ptr<RayWeatherEffect>> effects_;

    double sample_surface_reflectivity(const LidarEcho& surface_echo, Random& random) const;
    void append_surface_echo(EchoCandidates& candidates, LidarEcho echo, double wet_ground_brightness,
                             Random& random) const;
};

/// Adds a return to the candidates if the sensor can detect it after the air has
/// attenuated its light.
/// @param transmission  share of the light that the air does not absorb or scatter
void append_echo_if_detectable(EchoCandidates& candidates, LidarEcho echo,
                               const WeatherSensorProperties& sensor, double transmission);

/// Adds weather to a scan. Surfaces become darker, or their rays are dropped. If the
/// weather itself causes a return, the ray gets the range and intensity of this return.
/// The ray then has instance -1 and no surface values. The channel `source` stores the
/// cause of each return. Clear air changes only this channel. The result depends only on
/// seed and time, not on the number of threads.
/// @param scan  the scan of the input
void add_weather_to_scan(RenderedScan& scan, const WeatherInput& weather_input);

}  // namespace relidar
