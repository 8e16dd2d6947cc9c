// SPDX-License-Identifier: Apache-2.0
// Fog, rain and snow between a sensor and what it sees: light that is lost on the way,
// and returns of what hangs or falls in the air; water on the ground, which darkens it
// and mirrors what stands on it; the sun and reflectors, whose light blinds a sensor.
// Powers are relative: a surface of reflectivity rho at R metres returns rho / R^2 in
// clear air, rho exp(-2 alpha R) / R^2 in weather. (Not in the paper; docs/method.md has
// the models and their sources.)
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <string>
#include <vector>

namespace relidar {

class Random;

/// Where the sun stands, and how much of it arrives.
struct Sun {
    double azimuth_deg = 0.0;  ///< from the x axis of the dataset's world towards its y axis
    double elevation_deg = 0.0;
    double klux = 0.0;  ///< on what faces it; 100 on a clear day; 0: there is none

    bool operator==(const Sun&) const = default;
};

/// What is in the air, on the ground and in the sky, everywhere alike.
struct Weather {
    double fog_visibility_m = std::numeric_limits<double>::infinity();  ///< where 5 % of the light is left
    double rain_mm_h = 0.0;                                             ///< millimetres of water an hour
    double snow_mm_h = 0.0;                                             ///< the same, melted
    double wet_mm = 0.0;  ///< depth of the water on level ground
    Sun sun = {};
    /// that a retro-reflector of one square degree lends rays one degree beside it: the
    /// reflectivity that its stray light looks like, the median over beams
    double bloom = 0.0;

    bool clear() const { return *this == Weather{}; }
    bool operator==(const Weather&) const = default;
};

/// Reads "fog=VISIBILITY_m", "rain=MM_PER_H", "snow=MM_PER_H", "wet=MILLIMETRES",
/// "sun=AZIMUTH:ELEVATION" in degrees or "sun=AZIMUTH:ELEVATION:KLUX" (without: 100),
/// "bloom=REFLECTIVITY" (or "bloom": 1.2e-4), or several with commas between; "clear" or
/// nothing is clear air, dry ground and no sun.
/// @throws UsageError for other words, for numbers that are no weather, and for rain and
/// snow at once
Weather parse_weather(const std::string& text);
/// As parse_weather() reads it; "clear" for clear air.
std::string to_text(const Weather& weather);
/// @throws UsageError as parse_weather() for the same numbers
void check_weather(const Weather& weather);

/// What of a sensor decides how it takes weather. Its wavelength is 905 nm; near infrared
/// light of others is weakened alike by particles as large as these.
struct WeatherSensor {
    double divergence_rad = 0.003;  ///< full divergence of the beams
    double aperture_m = 0.01;       ///< width of a beam where it leaves the sensor
    double pulse_s = 6e-9;          ///< full width of the pulse at half of its peak
    double separation_m = 0.5;      ///< returns nearer to each other are one
    double min_range_m = 0.0;       ///< nothing nearer is a return; of the air nothing nearer than 1 m
    double max_range_m = 80.0;
    double darkest = 0.5 / 255.0;  ///< half a step of the sensor's intensities
    /// Reflectivity below which nothing is returned at any range, because receivers are
    /// less sensitive to near targets (sensitivity-time control). 0: weakest() is the
    /// only threshold.
    double weakest_reflectivity = 0.0;

    /// Power of the weakest return that is one: of the darkest surface where the range
    /// ends.
    double weakest() const { return darkest / (max_range_m * max_range_m); }
    /// Power that a surface, the air, a drop or noise needs at a range to be reported.
    /// Mirrored and stray light need weakest().
    double threshold(double range_m) const;
};

/// Why there is a point: the values of the channel `source`.
enum class PointSource : std::int32_t {
    nothing = -1,
    surface = 0,
    fog = 1,
    rain = 2,
    snow = 3,
    /// a surface that wet ground mirrors: as far behind the ground as the light went on
    /// from there
    mirror = 4,
    noise = 5,    ///< nothing: light of the sun that looks like a return
    blooming = 6  ///< stray light of a retro-reflector elsewhere
};

/// A return of a ray.
struct Echo {
    double range_m = 0.0;  ///< along the ray; 0: there is none
    /// that a surface in clear air would have to return as much; of a surface 0..1
    double reflectivity = 0.0;
    PointSource source = PointSource::nothing;
    double through_water = 1.0;  ///< share of it that water on the way leaves; 1 of what look() returns
};

/// What a sensor with one or two returns says of a ray; and what look() is told of it
/// beside, of which it returns nothing.
struct RayEchoes {
    Echo strongest, second;
    Echo mirrored = {};  ///< by wet ground
    Echo stray = {};     ///< of a retro-reflector
    /// angle between ray and sun; infinite where no sun is seen
    double from_sun_rad = std::numeric_limits<double>::infinity();
};

/// Share of the light that a metre takes away, 1/m: alpha of exp(-alpha R).
double extinction(const Weather& weather);

/// Share of light that a smooth surface of water mirrors (Fresnel, not polarised, n =
/// 1.33).
/// @param cosine  of the angle of incidence in air, 0..1
double mirrored_by_water(double cosine);
/// What ground under a film of water returns towards the light, over what it returns dry
/// (Lekner and Dorf 1988): light passes the surface twice, and what the ground scatters
/// is kept in the film by total reflection until it leaves or is absorbed:
///   (1 - F(cosine))^2 / (n^2 (1 - albedo p)),  p = 1 - (1 - mean of F over a dull surface's light) / n^2
/// @param albedo  of the dry ground, 0..1
double wet_over_dry(double cosine, double albedo);
/// Share of the ground that a film covers: all of it where the water is as deep as the
/// texture of asphalt, 1 mm (an assumption).
double film_share(double wet_mm);

/// How the noise of a receiver scatters in the light of the sun, by shot noise in a
/// matched filter: the standard deviation of what it adds to powers. Radiance that
/// arrives is 5 E (1 deg / angle)^2 1/sr off a dusty window, E / pi times the albedo of
/// the surface, which is taken to face the sun, and E over its solid angle where its disc
/// is in view.
/// @param from_sun_rad  angle between ray and sun @param albedo  of the surface that the
/// ray meets, 0: none
/// @param sees_sky  whether nothing is between
double sun_noise(const Sun& sun, const WeatherSensor& sensor, double from_sun_rad, double albedo,
                 bool sees_sky);
/// How often noise rises above a level of so many standard deviations, per metre of
/// range: that of Gaussian noise through a matched filter, exp(-level^2 / 2) / (2 sqrt(3)
/// tau) a second (Rice 1945; RCA Electro-Optics Handbook 1974).
double false_returns_per_m(const WeatherSensor& sensor, double level);

/// What falls: N(D) = N0 exp(-Lambda D) particles per cubic metre and millimetre of
/// diameter D, as water.
struct Particles {
    PointSource source = PointSource::nothing;
    double per_m3_mm = 0.0;     ///< N0; 0: nothing falls
    double slope_per_mm = 1.0;  ///< Lambda
    double widening = 1.0;      ///< diameter over that of the same as water
    double reflectivity = 0.0;
};
/// Those of rain or snow, by the water that falls in an hour.
Particles falling_in(const Weather& weather);

/// What comes back from the air along any ray of a sensor, and what the air leaves of
/// surfaces.
///   fog:        power(R) = pi beta integral p(x) exp(-2 alpha r) / r^2 dx,  r = R + x,  p(x) = cos^2(pi x / (c tau)), |x| <= c tau / 2,
///               from 1 m on; beta of each stretch of c tau / 2 is drawn, log-normal with mean 1 times 0.046 / visibility
///   drop, flake: power(D, R) = rho (D / B(R))^2 exp(-2 alpha R) / R^2,  B(R) the width of the beam; those of N(D) = N0 exp(-Lambda D) per
///               cubic metre and millimetre that are bright enough, a Poisson process along the beam
///   noise:      what rises above the weakest power, a Poisson process along the ray, whatever is there
class Air {
public:
    /// @throws UsageError as check_weather()
    Air(const Weather& weather, const WeatherSensor& sensor);
    bool clear() const { return weather_.clear(); }
    double max_range_m() const { return sensor_.max_range_m; }
    /// What is seen along a ray: of surfaces and what is in front of them the strongest
    /// return; and as second the last one, or where the strongest is the last the next
    /// strongest, if they are as far apart as the sensor needs. What is too weak is none.
    /// @param surfaces  what the ray returns in clear air @param free_m  how far it goes
    /// before it is blocked
    RayEchoes look(const RayEchoes& surfaces, double free_m, std::uint64_t seed) const;

private:
    const Weather weather_;
    const WeatherSensor sensor_;
    const Particles falling_;
    const double alpha_;
    std::vector<double> fog_power_;  // [k] mean power from nearest + k steps
    std::vector<double> particles_;  // [k] how many are bright enough on the way up to there, on average

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
