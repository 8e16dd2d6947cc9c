// SPDX-License-Identifier: Apache-2.0
// Reads and writes weather as text, and computes the extinction coefficient alpha. For
// fog, alpha follows from the definition of the visibility V: exp(-alpha V) = 0.05.
// Raindrops and snowflakes remove twice the light that their cross section covers (Q_ext
// = 2), because they are much larger than the wavelength.
#include <relidar/simulate/weather.hpp>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <iterator>
#include <optional>
#include <string_view>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

#include "base/files.hpp"
#include "base/list_text.hpp"

namespace relidar {
namespace {

constexpr const char* kExpected =
    "fog=VISIBILITY_m, rain=MM_PER_H, snow=MM_PER_H, wet=MILLIMETRES, "
    "sun=AZIMUTH:ELEVATION or bloom=REFLECTIVITY, or several of them";
constexpr const char* kSun =
    "sun=AZIMUTH:ELEVATION or sun=AZIMUTH:ELEVATION:KLUX with an azimuth from -360 to 360 "
    "degrees, an elevation from 0 to 90 degrees and an illuminance above 0 and up to 150 klux";
constexpr double kUsual_klux = 100.0;  // illuminance on a clear day

struct Kind {
    std::string_view name;
    double Weather::*value;
    double least, most;
    const char* range;
    double usual = 0.0;  ///< value if the text has no number; 0 if the text must have a number
};
constexpr Kind kKinds[] = {
    {"fog", &Weather::fog_visibility_m, 1.0, 1e6, "a visibility of 1 to 1e6 metres"},
    {"rain", &Weather::rain_mm_h, 0.0, 500.0, "0 to 500 mm/h"},
    {"snow", &Weather::snow_mm_h, 0.0, 100.0, "0 to 100 mm/h of melted snow"},
    {"wet", &Weather::wet_mm, 0.0, 10.0, "0 to 10 mm of water on the ground"},
    {"bloom", &Weather::bloom, 0.0, 1.0, "a reflectivity of 0 to 1", 1.2e-4},
};

bool is_weather(const Kind& kind, double value) { return value >= kind.least && value <= kind.most; }
bool is_sun(const Sun& sun) {
    return std::abs(sun.azimuth_deg) <= 360.0 && sun.elevation_deg >= 0.0 && sun.elevation_deg <= 90.0 &&
           sun.klux > 0.0 && sun.klux <= 150.0;
}

[[noreturn]] void refuse(const Kind& kind, const std::string& found) {
    throw UsageError(fmt::format("weather: found {}={}, expected {}", kind.name, found, kind.range));
}

/// Parses a number.
/// @return nothing if the text is not a number
std::optional<double> number_of(std::string_view text) {
    double value = 0.0;
    const char* end = text.data() + text.size();
    const auto [stop, error] = std::from_chars(text.data(), end, value);
    return error == std::errc{} && stop == end ? std::optional(value) : std::nullopt;
}

Sun read_sun(std::string_view text) {
    Sun sun{.klux = kUsual_klux};
    double* const values[] = {&sun.azimuth_deg, &sun.elevation_deg, &sun.klux};
    std::size_t n = 0, begin = 0;
    for (bool more = true; more; ++n) {
        const std::size_t colon = text.find(':', begin);
        const std::optional<double> value = number_of(text.substr(begin, colon - begin));
        if (n >= std::size(values) || !value)
            throw UsageError(fmt::format("weather: found sun={}, expected {}", excerpt(text), kSun));
        *values[n] = *value;
        more = colon != std::string_view::npos;
        begin = colon + 1;
    }
    if (n < 2 || !is_sun(sun))
        throw UsageError(fmt::format("weather: found sun={}, expected {}", excerpt(text), kSun));
    return sun;
}

std::string sun_text(const Sun& sun) {
    const std::string where = fmt::format("sun={}:{}", sun.azimuth_deg, sun.elevation_deg);
    return sun.klux == kUsual_klux ? where : fmt::format("{}:{}", where, sun.klux);
}

/// Parses one weather setting, for example "rain=5".
/// @param equals position of the equals sign, or the length of the word
void read_word(Weather& weather, std::string_view word, std::size_t equals) {
    const auto twice = [](std::string_view name) {
        throw UsageError(fmt::format("weather: {} occurs twice, expected it once", name));
    };
    const std::string_view name = word.substr(0, equals),
                           text = word.substr(std::min(equals + 1, word.size()));
    if (name == "sun" && equals < word.size()) {
        if (weather.sun != Sun{}) twice(name);
        weather.sun = read_sun(text);
        return;
    }
    const auto* kind = std::ranges::find(kKinds, name, &Kind::name);
    if (kind == std::end(kKinds) || (equals == word.size() && kind->usual == 0.0))
        throw UsageError(fmt::format("weather: found \"{}\", expected {}", excerpt(word), kExpected));
    double& value = weather.*kind->value;
    if (value != Weather{}.*kind->value) twice(name);
    const std::optional<double> given = equals == word.size() ? kind->usual : number_of(text);
    if (!given || !is_weather(*kind, *given)) refuse(*kind, excerpt(text));
    value = *given;
}

}  // namespace

Weather parse_weather(const std::string& text) {
    Weather weather;
    if (text == "clear") return weather;
    for (const std::string& word : words_of(text))
        read_word(weather, word, std::min(word.find('='), word.size()));
    check_weather(weather);
    return weather;
}

std::string to_text(const Weather& weather) {
    const Weather clear;
    std::vector<std::string> words;
    for (const Kind& kind : kKinds)
        if (const double value = weather.*kind.value; value != clear.*kind.value)
            words.push_back(fmt::format("{}={}", kind.name, value));
    if (weather.sun != Sun{}) words.push_back(sun_text(weather.sun));
    return words.empty() ? "clear" : fmt::format("{}", fmt::join(words, ","));
}

void check_weather(const Weather& weather) {
    const Weather clear;
    for (const Kind& kind : kKinds) {
        const double value = weather.*kind.value;
        if (value != clear.*kind.value && !is_weather(kind, value)) refuse(kind, fmt::format("{}", value));
    }
    if (weather.sun != Sun{} && !is_sun(weather.sun))
        throw UsageError(fmt::format("weather: found {}, expected {}", sun_text(weather.sun), kSun));
    if (weather.rain_mm_h > 0.0 && weather.snow_mm_h > 0.0)
        throw UsageError(fmt::format("weather: found rain={} and snow={}, expected only one of them",
                                     weather.rain_mm_h, weather.snow_mm_h));
}

double extinction(const Weather& weather) {
    const Particles p = falling_in(weather);
    const double shadows =
        p.per_m3_mm > 0.0 ? kPi * p.per_m3_mm * 1e-6 * p.widening * p.widening / std::pow(p.slope_per_mm, 3)
                          : 0.0;
    return std::log(20.0) / weather.fog_visibility_m + shadows;
}

Particles falling_in(const Weather& weather) {
    // Drop size distribution of Marshall and Palmer (1948). A drop reflects like water at
    // normal incidence, ((n - 1) / (n + 1))^2.
    if (weather.rain_mm_h > 0.0)
        return {PointSource::rain, 8000.0, 4.1 * std::pow(weather.rain_mm_h, -0.21), 1.0, 0.02};
    // Distribution of melted diameters of Gunn and Marshall (1958). A flake is wider than
    // its melted drop, because its density is a tenth of the density of water.
    if (weather.snow_mm_h > 0.0)
        return {PointSource::snow, 3.8e3 * std::pow(weather.snow_mm_h, -0.87),
                2.55 * std::pow(weather.snow_mm_h, -0.48), std::cbrt(10.0), 0.25};
    return {};
}

}  // namespace relidar
