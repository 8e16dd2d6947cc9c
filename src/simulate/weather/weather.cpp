// SPDX-License-Identifier: Apache-2.0
// Converts weather between numbers and text, whose form kWeatherEffects describes.
#include <relidar/simulate/weather.hpp>

#include <charconv>
#include <iterator>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/list_text.hpp"

namespace relidar {
namespace {

std::vector<double> parameters_of(const WeatherEffectEntry& effect, Weather weather) {
    std::vector<double> values;
    for (const WeatherParameter& number : effect.numbers) values.push_back(number.of(weather));
    return values;
}

bool has_valid_values(const WeatherEffectEntry& effect, const std::vector<double>& values) {
    for (std::size_t k = 0; k < values.size(); ++k)
        if (!(values[k] >= effect.numbers[k].least && values[k] <= effect.numbers[k].most)) return false;
    return true;
}

/// Formats a weather effect as text, for example "rain=5". Leaves out optional numbers
/// that have their default values.
std::string format_effect(const WeatherEffectEntry& effect, const Weather& weather) {
    std::vector<double> values = parameters_of(effect, weather);
    while (values.size() > std::max<std::size_t>(effect.n_required, 1) &&
           values.back() == effect.numbers[values.size() - 1].usual)
        values.pop_back();
    return fmt::format("{}={}", effect.name, fmt::join(values, ":"));
}

[[noreturn]] void fail_weather(const std::string& word, const std::string_view expected) {
    fail<UsageError>("weather: found {}, expected {}", word, expected);
}

/// Parses numbers that are separated by colons.
/// @return an empty list if a number cannot be read
std::vector<double> parse_numbers(std::string_view text) {
    std::vector<double> values;
    while (true) {
        const std::size_t colon = std::min(text.find(':'), text.size());
        double value = 0.0;
        const auto [stop, error] = std::from_chars(text.data(), text.data() + colon, value);
        if (error != std::errc{} || stop != text.data() + colon) return {};
        values.push_back(value);
        if (colon == text.size()) return values;
        text.remove_prefix(colon + 1);
    }
}

/// Returns the effect whose form fits the text, for example "bloom" or "rain=5".
/// @throws UsageError if the name is unknown, or if the effect needs numbers
const WeatherEffectEntry& find_effect(std::string_view effect_text) {
    const bool has_numbers = effect_text.find('=') != std::string_view::npos;
    std::vector<std::string_view> forms;
    for (const WeatherEffectEntry* effect : kWeatherEffects) {
        const bool fits = has_numbers || effect->n_required == 0;
        if (fits && effect->name == effect_text.substr(0, effect_text.find('='))) return *effect;
        forms.push_back(effect->form);
    }
    fail_weather(fmt::format("\"{}\"", quote(effect_text)),
                 fmt::format("{}, or several of them separated by commas", fmt::join(forms, ", ")));
}

/// Parses the text of one weather effect, for example "rain=5".
/// @throws UsageError for an unknown, repeated or incomplete effect
void parse_effect(Weather& weather, std::string_view effect_text) {
    const WeatherEffectEntry& effect = find_effect(effect_text);
    if (effect.is_active(weather))
        fail<UsageError>("weather: {} occurs twice, expected it once", effect.name);
    std::vector<double> values;
    if (effect_text != effect.name) {
        values = parse_numbers(effect_text.substr(effect.name.size() + 1));  // after the =
        if (values.size() < std::max<std::size_t>(effect.n_required, 1) ||
            values.size() > effect.numbers.size() || !has_valid_values(effect, values))
            fail_weather(quote(effect_text), effect.expected);
    }
    // Numbers that the text leaves out get their usual values.
    for (std::size_t k = 0; k < effect.numbers.size(); ++k)
        effect.numbers[k].of(weather) = k < values.size() ? values[k] : effect.numbers[k].usual;
}

}  // namespace

bool WeatherEffectEntry::is_active(const Weather& weather) const {
    return parameters_of(*this, weather) != parameters_of(*this, {});
}

Weather parse_weather(const std::string& text) {
    Weather weather;
    if (text == "clear") return weather;
    for (const std::string& word : split_list(text)) parse_effect(weather, word);
    check_weather(weather);
    return weather;
}

std::string format_weather(const Weather& weather) {
    std::vector<std::string> words;
    for (const WeatherEffectEntry* effect : kWeatherEffects)
        if (effect->is_active(weather)) words.push_back(format_effect(*effect, weather));
    return words.empty() ? "clear" : fmt::format("{}", fmt::join(words, ","));
}

void check_weather(const Weather& weather) {
    for (const WeatherEffectEntry* effect : kWeatherEffects)
        if (effect->is_active(weather) && !has_valid_values(*effect, parameters_of(*effect, weather)))
            fail_weather(format_effect(*effect, weather), effect->expected);
    if (weather.rain_mm_h > 0.0 && weather.snow_mm_h > 0.0)
        fail<UsageError>("weather: found rain={} and snow={}, expected only one of them", weather.rain_mm_h,
                         weather.snow_mm_h);
}

double extinction_per_m(const Weather& weather) {
    double alpha = 0.0;
    for (const WeatherEffectEntry* effect : kWeatherEffects)
        if (effect->extinction && effect->is_active(weather)) alpha += effect->extinction(weather);
    return alpha;
}

std::string weather_help() {
    std::vector<std::string> words;
    for (const WeatherEffectEntry* effect : kWeatherEffects)
        words.push_back(effect->meaning.empty() ? std::string(effect->form)
                                                : fmt::format("{} ({})", effect->form, effect->meaning));
    return fmt::format("{}, or several separated by commas", fmt::join(words, ", "));
}

}  // namespace relidar
