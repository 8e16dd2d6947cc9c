// SPDX-License-Identifier: Apache-2.0
// Fog, rain and snow between a sensor and what it sees: light that is lost on the way, and returns of what hangs or falls in the air.
// (Not in the paper; docs/method.md has the models and their sources.)
#pragma once

#include <cstdint>
#include <limits>
#include <string>

namespace relidar {

struct RenderedScan;

/// What is in the air, everywhere alike.
struct Weather {
    double fog_visibility_m = std::numeric_limits<double>::infinity();   ///< meteorological optical range: 5 % of the light is left after it
    double rain_mm_h = 0.0;   ///< millimetres of water an hour
    double snow_mm_h = 0.0;   ///< the same, melted

    bool clear() const { return !(fog_visibility_m < std::numeric_limits<double>::infinity()) && rain_mm_h == 0.0 && snow_mm_h == 0.0; }
    bool operator==(const Weather&) const = default;
};

/// Reads "fog=VISIBILITY_m", "rain=MM_PER_H", "snow=MM_PER_H" or several with commas between; "clear" or nothing is clear air.
/// @throws UsageError for other words, for numbers that are no weather, and for rain and snow at once
Weather parse_weather(const std::string& text);
/// As parse_weather() reads it.
std::string to_text(const Weather& weather);

/// What of a sensor decides how it takes weather.
struct WeatherSensor {
    double divergence_rad = 0.003;   ///< full divergence of the beams; 3 mrad where a sensor's is not known
    double aperture_m = 0.01;        ///< width of a beam where it leaves the sensor
    double pulse_s = 6e-9;           ///< full width of the pulse at half of its peak
    double min_range_m = 1.0;        ///< nothing nearer is a return
    /// weakest return that is one: intensity over the square of its range in metres. By default a surface that returns half a hundredth
    /// at 80 m
    double weakest = 0.005 / (80.0 * 80.0);
};

/// Why there is a point: the values of the channel `source`.
enum class PointSource : std::int32_t { nothing = -1, surface = 0, fog = 1, rain = 2, snow = 3 };

/// Share of the light that a metre takes away, 1/m: alpha of exp(-alpha range).
double extinction(const Weather& weather);

/// Puts weather between the sensor and a scan. What returned is weaker by exp(-2 alpha range); along each ray fog and each drop or flake
/// that is bright enough returns light, too; the strongest return is the ray's, the next one its second return where the scan has these
/// and where a pulse tells the two apart. What is weaker than the sensor's weakest is none. A ray whose drop_prob is 0.5 or more had no
/// return of a surface. Afterwards rays that returned weather belong to no instance, their channels of surfaces say nothing, and the
/// channel `source` says why a point is there. Clear weather changes nothing but that channel.
/// @param at_range  IntensityResponse::at_range: how bright a sensor reports the same surface at a range; none: alike
/// @param seed  the same for the same seed and time
void add_weather(RenderedScan& scan, const Weather& weather, const WeatherSensor& sensor, std::uint64_t seed,
                 const struct IntensityResponse* response = nullptr);

}  // namespace relidar
