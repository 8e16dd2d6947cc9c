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

namespace relidar {

// Range in metres from which the receiver sees the laser beam. Air that is nearer returns
// no light to the receiver (Hahner et al. 2021).
inline constexpr double kOverlap_m = 1.0;
inline constexpr double kLight_m_s = 299792458.0;

/// Returns the minimum range in metres at which the air can cause a return.
inline double compute_nearest_m(const WeatherSensor& sensor) {
    return std::max(kOverlap_m, sensor.min_range_m);
}
inline double compute_pulse_length_m(const WeatherSensor& sensor) { return kLight_m_s * sensor.pulse_s; }
/// Returns the diameter of the laser beam at a given range, in metres.
inline double compute_beam_diameter_m(const WeatherSensor& sensor, double range_m) {
    return sensor.aperture_m + sensor.divergence_rad * range_m;
}

/// Input of all weather effects: the weather, a scan, its sensor, and the scene around
/// it.
struct WeatherInput {
    const Weather& weather;
    const WeatherSensor& sensor;
    const RenderedScan& scan;  ///< scan in clear air, without weather
    /// model of how the reported intensity of a surface depends on its range
    const IntensityResponse& response;
    glm::dvec3 world_offset_m{0.0};  ///< see Sequence::world_offset_m
    /// Traces additional rays through the scene at the time of the scan.
    std::function<Rendering(const WorldRays&)> trace = {};
    std::uint64_t seed = 0;
    /// [rays] true if an object close to the sensor blocks the ray. A blocked ray has no
    /// returns from fog, rain, snow or noise. An empty list means that no ray is blocked.
    std::vector<std::uint8_t> blind = {};
};

/// A ray of the scan, and the values that weather effects use and change.
struct RayInAir {
    std::size_t index = 0;             ///< index of the ray in its scan
    Echo strongest = {}, second = {};  ///< returns of surfaces in clear air
    double free_m = 0.0;               ///< distance in metres after which a surface blocks the ray
    double through_water = 1.0;        ///< brightness of the wet ground relative to the dry ground
};

/// A possible return of a ray that is bright enough for the sensor.
struct Candidate {
    Echo echo;
    double power;
};
using Candidates = std::vector<Candidate>;

/// A weather effect, such as rain, for the rays of one scan.
class EffectOnRays {
public:
    virtual ~EffectOnRays() = default;
    /// Changes the return of the surface that a ray hits, before the air attenuates the
    /// light.
    virtual void change_surface(RayInAir& /*ray*/) const {}
    /// Adds the possible returns that the effect causes on a ray, for example from
    /// raindrops.
    virtual void add_returns(Candidates& /*candidates*/, const RayInAir& /*ray*/, Random& /*random*/) const {}
};

/// The strongest return of a ray, and the second return if the sensor reports two
/// returns.
struct RayEchoes {
    Echo strongest, second;
};

/// Simulates what a sensor measures along a ray in weather. The air attenuates the return
/// of the surface, and weather effects add their own returns.
class Air {
public:
    /// Creates the weather effects for the rays of a scan.
    /// @throws UsageError if the weather is invalid, like check_weather()
    explicit Air(const WeatherInput& input);
    /// Creates the simulation with a given list of weather effects.
    Air(const Weather& weather, const WeatherSensor& sensor,
        std::vector<std::unique_ptr<EffectOnRays>> effects);
    /// Computes the returns that the sensor measures along a ray. Normally, the second
    /// return is the last one. If the strongest return is also the last, the second
    /// return is the second strongest. Both returns are at least `separation_m` apart.
    /// Returns below the detection threshold are left out.
    RayEchoes compute_echoes(RayInAir ray, std::uint64_t seed) const;

private:
    const WeatherSensor sensor_;
    const double alpha_;
    std::vector<std::unique_ptr<EffectOnRays>> effects_;

    double draw_surface_reflectivity(const Echo& surface, Random& random) const;
    void add_surface(Candidates& candidates, Echo echo, double through_water, Random& random) const;
};

/// Adds a return to the candidates if it is bright enough after the air has attenuated
/// its light.
/// @param transmission  share of the light that the air does not absorb or scatter
/// @param darkest  minimum reflectivity of the object
void add_echo(Candidates& candidates, Echo echo, const WeatherSensor& sensor, double transmission,
              double darkest = 0.0);

/// Adds weather to a scan. Surfaces become darker, or their rays are dropped. Where the
/// weather itself causes a return, the ray gets the range and intensity of this return.
/// Its instance is then -1, and it has no surface values. The channel `source` stores the
/// cause of each return. In clear air, nothing else changes. The result depends only on
/// seed and time, not on the number of threads.
/// @param scan  the scan of the input
void add_weather(RenderedScan& scan, const WeatherInput& input);

}  // namespace relidar
