// SPDX-License-Identifier: Apache-2.0
// Defines how effects of weather act on the rays of a scan. Each effect is a class in a
// file of this folder, and a row of kWeatherEffects. Private to simulate.
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

// Below this range, the receiver does not see the part of the air that the beam
// illuminates (Hahner et al. 2021).
inline constexpr double kOverlap_m = 1.0;
inline constexpr double kLight_m_s = 299792458.0;

/// Returns the minimum range of a return from the air.
inline double nearest_m(const WeatherSensor& sensor) { return std::max(kOverlap_m, sensor.min_range_m); }
inline double pulse_m(const WeatherSensor& sensor) { return kLight_m_s * sensor.pulse_s; }
/// Returns the width of a beam at a range.
inline double beam_diameter_m(const WeatherSensor& sensor, double range_m) {
    return sensor.aperture_m + sensor.divergence_rad * range_m;
}

/// Input of all weather effects: a scan, its sensor, and the scene around it.
struct WeatherInput {
    const Weather& weather;
    const WeatherSensor& sensor;
    const RenderedScan& scan;  ///< scan in clear air
    /// intensity that the sensor reports for the same surface as a function of range
    const IntensityResponse& response;
    glm::dvec3 world_offset_m{0.0};  ///< see Sequence::world_offset_m
    /// Traces rays through the scene at the time of the scan.
    std::function<Rendering(const WorldRays&)> trace = {};
    std::uint64_t seed = 0;
    /// [rays] true for rays that an object at the sensor blocks; empty if no ray is
    /// blocked. Such rays measure no fog, rain, snow or noise.
    std::vector<std::uint8_t> blind = {};
};

/// A ray on which weather acts.
struct RayInAir {
    std::size_t index = 0;             ///< index of the ray in its scan
    Echo strongest = {}, second = {};  ///< returns of surfaces in clear air
    double free_m = 0.0;               ///< distance after which the ray is blocked
    double through_water = 1.0;        ///< brightness of the wet ground relative to the dry ground
};

/// A possible return of a ray that is bright enough for the sensor.
struct Candidate {
    Echo echo;
    double power;
};
using Candidates = std::vector<Candidate>;

/// An effect of weather, prepared for the rays of a scan.
class EffectOnRays {
public:
    virtual ~EffectOnRays() = default;
    /// Changes the surface of a ray, before the air attenuates its light.
    virtual void change_surface(RayInAir& /*ray*/) const {}
    /// Adds the possible returns that the effect causes on a ray.
    virtual void add_returns(Candidates& /*candidates*/, const RayInAir& /*ray*/, Random& /*random*/) const {}
};

/// The strongest return of a ray, and the second return of a sensor that reports two.
struct RayEchoes {
    Echo strongest, second;
};

/// Simulates what a sensor measures along a ray in weather: surfaces, which the air
/// attenuates, and the returns of all effects.
class Air {
public:
    /// Prepares the effects of the weather for the rays of a scan.
    /// @throws UsageError like check_weather()
    explicit Air(const WeatherInput& input);
    /// Creates air with a given list of effects.
    Air(const Weather& weather, const WeatherSensor& sensor,
        std::vector<std::unique_ptr<EffectOnRays>> effects);
    /// Computes the returns that the sensor measures along a ray. The second return is
    /// the last return, or the next strongest if the strongest is also the last. The
    /// two returns are at least `separation_m` apart. Returns below the detection
    /// threshold are left out.
    RayEchoes look(RayInAir ray, std::uint64_t seed) const;

private:
    const WeatherSensor sensor_;
    const double alpha_;
    std::vector<std::unique_ptr<EffectOnRays>> effects_;

    double surface_reflectivity(const Echo& surface, Random& random) const;
    void add_surface(Candidates& candidates, Echo echo, double through_water, Random& random) const;
};

/// Adds an echo of light that reaches the sensor through the air, if it is bright enough.
/// @param transmission  share of the light that remains on its path
/// @param darkest  minimum reflectivity of the object
void add_echo(Candidates& candidates, Echo echo, const WeatherSensor& sensor, double transmission,
              double darkest = 0.0);

/// Adds the weather of the input to its scan. Surfaces become darker or are dropped. If
/// an effect causes the return of a ray, the ray gets the range and intensity of this
/// return. The ray also gets instance -1, and no values in channels that describe
/// surfaces. The channel `source` stores the cause of each return. Clear air changes
/// nothing else. The result depends only on seed and time, not on the number of
/// threads.
/// @param scan  the scan of the input
void add_weather(RenderedScan& scan, const WeatherInput& input);

}  // namespace relidar
