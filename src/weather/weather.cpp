// SPDX-License-Identifier: Apache-2.0
// Weather as text, and what it takes away: alpha of fog by the definition of visibility, exp(-alpha V) = 0.05; of drops and flakes the sum
// of their shadows, each of which takes twice its area of light (Q_ext = 2, particles far larger than the wavelength).
#include <relidar/weather.hpp>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <string_view>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/math.hpp>

#include "core/files.hpp"
#include "core/list_text.hpp"

namespace relidar {
namespace {

constexpr const char* kExpected = "fog=VISIBILITY_m, rain=MM_PER_H, snow=MM_PER_H or wet=MILLIMETRES, or several of them";

struct Kind {
    std::string_view name;
    double Weather::*value;
    double least, most;
    const char* range;
};
constexpr Kind kKinds[] = {
    {"fog", &Weather::fog_visibility_m, 1.0, 1e6, "a visibility of 1 to 1e6 metres"},
    {"rain", &Weather::rain_mm_h, 0.0, 500.0, "0 to 500 mm/h"},
    {"snow", &Weather::snow_mm_h, 0.0, 100.0, "0 to 100 mm/h of melted snow"},
    {"wet", &Weather::wet_mm, 0.0, 10.0, "0 to 10 mm of water on the ground"},
};

bool is_weather(const Kind& kind, double value) { return value >= kind.least && value <= kind.most; }

[[noreturn]] void refuse(const Kind& kind, const std::string& found) {
    throw UsageError(fmt::format("weather: found {}={}, expected {}", kind.name, found, kind.range));
}

}  // namespace

Weather parse_weather(const std::string& text) {
    const Weather clear;
    Weather weather;
    if (text == "clear") return weather;
    for (const std::string& word : words_of(text)) {
        const std::size_t equals = std::min(word.find('='), word.size());
        const auto* kind = std::ranges::find(kKinds, std::string_view(word).substr(0, equals), &Kind::name);
        if (kind == std::end(kKinds) || equals == word.size())
            throw UsageError(fmt::format("weather: found \"{}\", expected {}", excerpt(word), kExpected));
        double& value = weather.*kind->value;
        if (value != clear.*kind->value) throw UsageError(fmt::format("weather: found {} twice, expected it once", kind->name));
        const char *begin = word.data() + equals + 1, *end = word.data() + word.size();
        const auto [stop, error] = std::from_chars(begin, end, value);
        if (error != std::errc{} || stop != end || !is_weather(*kind, value)) refuse(*kind, excerpt(std::string_view(begin, end)));
    }
    check_weather(weather);
    return weather;
}

std::string to_text(const Weather& weather) {
    const Weather clear;
    std::string text;
    for (const Kind& kind : kKinds)
        if (const double value = weather.*kind.value; value != clear.*kind.value)
            text += fmt::format("{}{}={}", text.empty() ? "" : ",", kind.name, value);
    return text.empty() ? "clear" : text;
}

void check_weather(const Weather& weather) {
    const Weather clear;
    for (const Kind& kind : kKinds) {
        const double value = weather.*kind.value;
        if (value != clear.*kind.value && !is_weather(kind, value)) refuse(kind, fmt::format("{}", value));
    }
    if (weather.rain_mm_h > 0.0 && weather.snow_mm_h > 0.0)
        throw UsageError(fmt::format("weather: found rain={} and snow={}, expected one of them", weather.rain_mm_h, weather.snow_mm_h));
}

double extinction(const Weather& weather) {
    const Particles p = falling_in(weather);
    const double shadows = p.per_m3_mm > 0.0 ? kPi * p.per_m3_mm * 1e-6 * p.widening * p.widening / std::pow(p.slope_per_mm, 3) : 0.0;
    return std::log(20.0) / weather.fog_visibility_m + shadows;
}

Particles falling_in(const Weather& weather) {
    if (weather.rain_mm_h > 0.0)   // Marshall and Palmer 1948; a drop mirrors as water does at normal incidence, ((n - 1) / (n + 1))^2
        return {PointSource::rain, 8000.0, 4.1 * std::pow(weather.rain_mm_h, -0.21), 1.0, 0.02};
    if (weather.snow_mm_h > 0.0)   // Gunn and Marshall 1958, of melted diameters; a flake of a tenth of water's density is wider
        return {PointSource::snow, 3.8e3 * std::pow(weather.snow_mm_h, -0.87), 2.55 * std::pow(weather.snow_mm_h, -0.48), std::cbrt(10.0),
                0.25};
    return {};
}

}  // namespace relidar
