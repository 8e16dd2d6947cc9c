// SPDX-License-Identifier: Apache-2.0
// Weather models for LiDAR. Fog, rain and snow attenuate light and return light to the
// sensor. Water on the ground darkens the ground and mirrors objects. Sunlight and stray
// light of reflectors cause false returns. Powers are relative: a surface with
// reflectivity rho at R metres returns rho / R^2 in clear air, and rho exp(-2 alpha R) /
// R^2 in weather. (Not in the paper; docs/method.md has the models and their sources.)
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <string_view>

namespace relidar {

struct Sun {
    /// from the x axis of the dataset's world towards its y axis
    double azimuth_deg = 0.0;
    double elevation_deg = 0.0;
    /// illuminance of a surface that faces the sun: 100 on a clear day
    double klux = 0.0;

    bool operator==(const Sun&) const = default;
};

/// The same everywhere in the scene.
struct Weather {
    double fog_visibility_m = std::numeric_limits<double>::infinity();
    double rain_mm_h = 0.0;  ///< rain rate in millimetres of water per hour
    double snow_mm_h = 0.0;  ///< snow rate in millimetres of melted water per hour
    double wet_mm = 0.0;     ///< depth of the water on level ground
    Sun sun = {};
    /// Stray light of a bright retro-reflector on neighbouring rays: their reflectivity
    /// (median over the beams) one degree away from a reflector of one square degree.
    double bloom = 0.0;

    bool is_clear() const { return *this == Weather{}; }
    bool operator==(const Weather&) const = default;
};

/// Parses words of kWeatherEffects separated by commas, for example "rain=5,wet=0.5".
/// "clear" or an empty text means clear air, dry ground and no sun.
/// @throws UsageError for an unknown word, for a number out of range, and for rain
/// together with snow
Weather parse_weather(const std::string& text);
/// Formats weather as text that parse_weather() reads; "clear" for clear air.
std::string format_weather(const Weather& weather);
/// Checks that all values of the weather are in their ranges.
/// @throws UsageError for the same values as parse_weather()
void check_weather(const Weather& weather);

/// Properties of a sensor for weather. The wavelength is 905 nm; other near-infrared
/// wavelengths give the same results, because particles are much larger.
struct WeatherSensorProperties {
    double divergence_rad = 0.003;  ///< full divergence of the beams
    double aperture_m = 0.01;       ///< width of a beam at the sensor
    double pulse_s = 6e-9;          ///< full width of the pulse at half maximum
    /// Returns that are closer to each other are merged.
    double separation_m = 0.5;
    /// At least 1 m for returns from fog, rain and snow.
    double min_range_m = 0.0;
    double max_range_m = 80.0;
    /// Reflectivity of a surface at the maximum range with the power of the weakest peak
    /// that the receiver detects. Limits noise and stray light.
    double darkest = 0.005;
    /// Darker surfaces are not detected, not even at short range, because the receiver is
    /// focused on far targets. 0 = no such limit.
    double weakest_reflectivity = 0.0;
    /// Weakest surface in a data sheet: reflectivity / range^2. 0 = no such limit.
    double min_specified_power = 0.0;
    /// Weakest stray light around a reflector. 0 = no such limit.
    double min_stray_power = 0.0;

    /// Returns the minimum power of noise and stray light that is detected: the power of
    /// the darkest surface at the maximum range.
    double floor_power() const { return darkest / (max_range_m * max_range_m); }
    /// Returns the minimum power that surfaces, fog, particles and mirrored objects must
    /// reach: the largest of floor_power(), `min_specified_power`, and the power of
    /// `weakest_reflectivity` at this range.
    double min_power_at(double range_m) const;
};

/// Values of the channel `source`.
enum class ReturnCause : std::int32_t {
    nothing = -1,
    surface = 0,
    fog = 1,
    rain = 2,
    snow = 3,
    /// Mirror image of an object in wet ground, below the ground: the range is the length
    /// of the light's path.
    mirror = 4,
    noise = 5,    ///< Sunlight that the receiver detects as a return, without an object.
    blooming = 6  ///< stray light of a retro-reflector in another direction
};

struct LidarEcho {
    double range_m = 0.0;  ///< Range along the ray. It is 0 if the ray has no return.
    /// Received power, as the reflectivity of a surface at range_m in clear air. Stray
    /// light can exceed 1.
    double reflectivity = 0.0;
    ReturnCause source = ReturnCause::nothing;
    double fall_mps = 0.0;  ///< speed at which rain or snow falls
    /// mirrored light: speed of the object along the mirrored ray, positive away from the
    /// water
    double away_mps = 0.0;
};

/// Returns the extinction coefficient alpha of the air in 1/m. Over R metres, the air
/// transmits exp(-alpha R) of the light.
double extinction_per_m(const Weather& weather);

/// Returns the fraction of light that a smooth water surface reflects (Fresnel,
/// unpolarised, n = 1.33).
/// @param cosine  of the angle of incidence in air, 0..1
double water_reflectance(double cosine);
/// Returns the light that wet ground returns, divided by the light that dry ground
/// returns (Lekner and Dorf 1988). Light passes the water surface twice.
/// Total reflection keeps a part of the scattered light in the water until it leaves or
/// is absorbed. F_mean is the mean of F over the light of a diffuse surface:
///   (1 - F(cosine))^2 / (n^2 (1 - albedo p)),  p = 1 - (1 - F_mean) / n^2
/// @param cosine  of the angle of incidence in air, 0..1
/// @param albedo  albedo of the dry ground, 0..1
double wet_ratio(double cosine, double albedo);
/// Returns the fraction of the ground that is covered by a film of water. It is 1 if the
/// water is at least 1 mm deep, the assumed texture depth of asphalt.
double film_fraction(double water_depth_mm);

/// Returns the standard deviation of the power after a matched filter. It is caused by
/// the shot noise of three sources:
/// - light scattered by a dusty window: 5 E (1 deg / angle)^2 1/sr;
/// - light reflected by the surface: E / pi times its albedo, as if it faces the sun;
/// - the solar disc, if it is in view: E divided by its solid angle.
/// @param albedo_or_0  albedo of the surface that the ray hits; 0: none
/// @param sees_sky  true if nothing is between the sensor and the sky
double sun_noise(const Sun& sun, const WeatherSensorProperties& sensor, double angle_rad, double albedo_or_0,
                 bool sees_sky);
/// Returns how often noise exceeds a threshold, per metre of range (2 / c seconds):
/// exp(-sigmas^2 / 2) / (2 sqrt(3) tau) times per second, where tau is the
/// pulse duration (Rice 1945; RCA Electro-Optics Handbook 1974).
/// @param sigmas  in standard deviations of the noise
double false_returns_per_m(const WeatherSensorProperties& sensor, double sigmas);

struct WeatherInput;
class RayWeatherEffect;

/// A number in the text of an effect, for example the visibility in "fog=50".
struct WeatherParameter {
    double& (*of)(Weather&);  ///< the field of the number
    double least, most;
    double usual = 0.0;  ///< Default value if the text does not contain the number.
};

/// Parser, help texts, viewer and Python module read this table.
struct WeatherEffectEntry {
    std::string_view name;                      ///< word of the effect, for example "fog"
    std::string_view form;                      ///< word with its numbers, for example "fog=VISIBILITY_m"
    std::string_view meaning;                   ///< explanation of the word, empty if the word is enough
    std::string_view expected;                  ///< valid numbers, for error messages
    std::string_view examples;                  ///< texts that the viewer offers, separated by spaces
    std::span<const WeatherParameter> numbers;  ///< in the text, colons separate the numbers
    std::size_t n_required = 1;                 ///< number of numbers that the text must have
    /// Null if the effect does not attenuate light.
    double (*extinction)(const Weather&) = nullptr;
    /// Returns null if no ray has the effect.
    std::unique_ptr<RayWeatherEffect> (*prepare)(const WeatherInput&) = nullptr;

    bool is_active(const Weather& weather) const;  ///< true if the weather has the effect
};

extern const WeatherEffectEntry kFogEffect, kRainEffect, kSnowEffect, kWetGroundEffect, kBloomingEffect,
    kSunlightEffect;
/// In the order in which they act on a ray.
inline constexpr const WeatherEffectEntry* kWeatherEffects[] = {
    &kFogEffect, &kRainEffect, &kSnowEffect, &kWetGroundEffect, &kBloomingEffect, &kSunlightEffect};
/// Returns a help text: the word of each weather effect and its meaning.
std::string weather_help();

}  // namespace relidar
