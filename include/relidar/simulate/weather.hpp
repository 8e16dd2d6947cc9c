// SPDX-License-Identifier: Apache-2.0
// Weather models for LiDAR. Fog, rain and snow attenuate light and return light to the
// sensor. Water on the ground darkens it and mirrors objects. Sunlight and stray light of
// reflectors cause false returns. Powers are relative: a surface with reflectivity rho at
// R metres returns rho / R^2 in clear air, and rho exp(-2 alpha R) / R^2 in weather. (Not
// in the paper; docs/method.md has the models and their sources.)
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <string>
#include <vector>

namespace relidar {

class Random;

/// Position of the sun and its illuminance.
struct Sun {
    /// Azimuth of the sun, measured from the x axis of the dataset's world towards its y
    /// axis.
    double azimuth_deg = 0.0;
    double elevation_deg = 0.0;
    /// Illuminance of a surface that faces the sun: 100 on a clear day, 0 without sun.
    double klux = 0.0;

    bool operator==(const Sun&) const = default;
};

/// State of the weather, which is the same everywhere in the scene.
struct Weather {
    /// Distance over which the fog attenuates light to 5 %.
    double fog_visibility_m = std::numeric_limits<double>::infinity();
    double rain_mm_h = 0.0;  ///< rain rate in millimetres of water per hour
    double snow_mm_h = 0.0;  ///< snow rate in millimetres of melted water per hour
    double wet_mm = 0.0;     ///< depth of the water on level ground
    Sun sun = {};
    /// Strength of blooming: stray light that a retro-reflector causes in neighbouring
    /// rays. It is the apparent reflectivity in rays one degree away from a
    /// retro-reflector of one square degree. Median over beams.
    double bloom = 0.0;

    bool clear() const { return *this == Weather{}; }
    bool operator==(const Weather&) const = default;
};

/// Parses a weather description. Its words are separated by commas. "clear" or an empty
/// text means clear air, dry ground and no sun.
///   fog=VISIBILITY_m
///   rain=MM_PER_H
///   snow=MM_PER_H
///   wet=MILLIMETRES
///   sun=AZIMUTH:ELEVATION[:KLUX]   degrees; default 100 klux
///   bloom[=REFLECTIVITY]           default 1.2e-4
/// @throws UsageError for an unknown word, for a number out of range, and for rain
/// together with snow
Weather parse_weather(const std::string& text);
/// Converts weather to text that parse_weather() can read. Returns "clear" for clear air.
std::string to_text(const Weather& weather);
/// Throws an exception if a value of the weather is out of range.
/// @throws UsageError for the same values as parse_weather()
void check_weather(const Weather& weather);

/// Properties of a sensor that determine how weather affects its scans. The wavelength is
/// 905 nm. Other near-infrared wavelengths behave the same, because fog, rain and snow
/// particles are much larger than the wavelength.
struct WeatherSensor {
    double divergence_rad = 0.003;  ///< full divergence of the beams
    double aperture_m = 0.01;       ///< width of a beam at the sensor
    double pulse_s = 6e-9;          ///< full width of the pulse at half maximum
    /// Minimum distance between two returns of a ray. Returns closer to each other are
    /// merged.
    double separation_m = 0.5;
    /// Minimum range of a return. For returns from fog, rain and snow, the minimum is at
    /// least 1 m.
    double min_range_m = 0.0;
    double max_range_m = 80.0;
    /// Half a quantisation step of the sensor's intensities. A darker surface is not
    /// detected at the maximum range.
    double darkest = 0.5 / 255.0;
    /// Reflectivity below which a surface is not detected at any range, because receivers
    /// are less sensitive to near targets (sensitivity-time control). With 0, weakest()
    /// is the only threshold.
    double weakest_reflectivity = 0.0;

    /// Returns the minimum power that is detected: the power of the darkest surface at
    /// the maximum range.
    double weakest() const { return darkest / (max_range_m * max_range_m); }
    /// Returns the minimum power that is detected at a range, for surfaces, fog,
    /// particles and noise. For mirrored and stray light, the minimum power is weakest().
    double threshold(double range_m) const;
};

/// Cause of a point. These are the values of the channel `source`.
enum class PointSource : std::int32_t {
    nothing = -1,
    surface = 0,
    fog = 1,
    rain = 2,
    snow = 3,
    /// A surface that is seen as a mirror image in wet ground. Its point is below the
    /// ground, at the total path length of the light.
    mirror = 4,
    noise = 5,    ///< Sunlight that the receiver detects as a return, without an object.
    blooming = 6  ///< stray light of a retro-reflector in another direction
};

/// A possible return of a ray.
struct Echo {
    double range_m = 0.0;  ///< Range along the ray. It is 0 if the ray has no return.
    /// Reflectivity of a surface that would return the same power in clear air. For the
    /// return of a surface, the value is in 0..1.
    double reflectivity = 0.0;
    PointSource source = PointSource::nothing;
    /// Fraction of the light that is left after it has passed through water. The value is
    /// 1 in results of look().
    double through_water = 1.0;
};

/// Returns of one ray of a sensor with one or two returns. Input and result of
/// Air::look(). The result sets only `strongest` and `second`.
struct RayEchoes {
    Echo strongest, second;
    Echo mirrored = {};  ///< Return of a surface that is mirrored by wet ground.
    Echo stray = {};     ///< Return that is caused by stray light of a retro-reflector.
    /// Angle between the ray and the direction to the sun. Infinite if the sun is not
    /// visible.
    double from_sun_rad = std::numeric_limits<double>::infinity();
};

/// Returns the extinction coefficient alpha of the air in 1/m. Over R metres, the air
/// transmits exp(-alpha R) of the light.
double extinction(const Weather& weather);

/// Returns the fraction of light that a smooth water surface reflects (Fresnel,
/// unpolarised, n = 1.33).
/// @param cosine  cosine of the angle of incidence in air, 0..1
double mirrored_by_water(double cosine);
/// Returns the ratio of the light that wet ground and dry ground return to the source
/// (Lekner and Dorf 1988). Light passes the water surface twice. The ground scatters
/// light, and total reflection keeps a part of it in the water film until it leaves or is
/// absorbed:
///   (1 - F(cosine))^2 / (n^2 (1 - albedo p)),  p = 1 - (1 - mean of F over a diffuse surface's light) / n^2
/// @param cosine  cosine of the angle of incidence in air, 0..1
/// @param albedo  albedo of the dry ground, 0..1
double wet_over_dry(double cosine, double albedo);
/// Returns the fraction of the ground that is covered by a film of water. The fraction is
/// 1 if the water is at least 1 mm deep, which is the assumed texture depth of asphalt.
double film_share(double wet_mm);

/// Returns the noise of a receiver in sunlight. It is the standard deviation of the power
/// after a matched filter, caused by shot noise. Three sources contribute radiance:
/// - light scattered by a dusty window: 5 E (1 deg / angle)^2 1/sr;
/// - light reflected by the surface: E / pi times its albedo, as if it faces the sun;
/// - the solar disc, if it is in view: E divided by its solid angle.
/// @param from_sun_rad  angle between ray and sun
/// @param albedo  albedo of the surface that the ray hits; 0: none
/// @param sees_sky  true if nothing is between the sensor and the sky
double sun_noise(const Sun& sun, const WeatherSensor& sensor, double from_sun_rad, double albedo,
                 bool sees_sky);
/// Returns how often noise exceeds a threshold, per metre of range. For Gaussian noise
/// after a matched filter, the rate is exp(-level^2 / 2) / (2 sqrt(3) tau) per second
/// (Rice 1945; RCA Electro-Optics Handbook 1974).
/// @param level  threshold in standard deviations
double false_returns_per_m(const WeatherSensor& sensor, double level);

/// Size distribution of rain or snow: N(D) = N0 exp(-Lambda D) particles per cubic metre
/// and per millimetre of diameter D. D is the diameter of the melted particle.
struct Particles {
    PointSource source = PointSource::nothing;
    double per_m3_mm = 0.0;     ///< N0; 0: no particles
    double slope_per_mm = 1.0;  ///< Lambda
    double widening = 1.0;      ///< Ratio of the particle's diameter to its diameter after melting.
    double reflectivity = 0.0;
};
/// Returns the size distribution of rain or snow for the precipitation rate of the
/// weather.
Particles falling_in(const Weather& weather);

/// Simulates the effect of the air along a ray: returns from fog, rain, snow and noise,
/// and the attenuation of surfaces.
///   fog          power(R) = pi beta integral p(x) exp(-2 alpha r) / r^2 dx
///                  r = R + x,  p(x) = cos^2(pi x / (c tau)),  |x| <= c tau / 2,  r >= 1 m;
///                  beta is drawn for each interval of length c tau / 2:
///                  log-normal with mean 0.046 / visibility
///   drop, flake  power(D, R) = rho (D / B(R))^2 exp(-2 alpha R) / R^2
///                  B(R): width of the beam; the particles of N(D) = N0 exp(-Lambda D) per
///                  cubic metre and millimetre that are bright enough, a Poisson process
///                  along the beam
///   noise        peaks above the minimum power: a Poisson process along the ray that does
///                  not depend on the objects there
class Air {
public:
    /// Precomputes the tables of fog and particles for a weather and a sensor.
    /// @throws UsageError like check_weather()
    Air(const Weather& weather, const WeatherSensor& sensor);
    bool clear() const { return weather_.clear(); }
    double max_range_m() const { return sensor_.max_range_m; }
    /// Computes the returns that the sensor measures along a ray. The strongest return
    /// comes from a surface, or from fog, particles or noise in front of it. The second
    /// return is the last return, or the next strongest if the strongest is also the
    /// last. The two returns are at least `separation_m` apart. Returns below the
    /// detection threshold are left out.
    /// @param surfaces  returns of the ray in clear air
    /// @param free_m  distance after which the ray is blocked
    RayEchoes look(const RayEchoes& surfaces, double free_m, std::uint64_t seed) const;

private:
    const Weather weather_;
    const WeatherSensor sensor_;
    const Particles falling_;
    const double alpha_;
    // [k] mean power that fog returns from a range: the nearest range plus k steps.
    std::vector<double> fog_power_;
    // [k] expected number of bright particles between the nearest range and the nearest
    // range plus k steps.
    std::vector<double> particles_;

    struct Candidate;
    double nearest_m() const;
    double beam_m(double range_m) const { return sensor_.aperture_m + sensor_.divergence_rad * range_m; }
    double smallest_mm(double range_m) const;
    double fog_power(double range_m) const;
    double surface_reflectivity(const Echo& surface, Random& random) const;
    void add_surfaces(std::vector<Candidate>& candidates, const RayEchoes& surfaces, Random& random) const;
    void add_fog(std::vector<Candidate>& candidates, double free_m, Random& random) const;
    void add_particles(std::vector<Candidate>& candidates, double free_m, Random& random) const;
    void add_noise(std::vector<Candidate>& candidates, const RayEchoes& surfaces, double free_m,
                   Random& random) const;
};

}  // namespace relidar
