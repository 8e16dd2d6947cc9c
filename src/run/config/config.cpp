// SPDX-License-Identifier: Apache-2.0
#include <relidar/run/config.hpp>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <map>
#include <set>
#include <sstream>

#define TOML_EXCEPTIONS 1
#include <toml++/toml.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/list_text.hpp"
#include "base/number_text.hpp"
#include "base/toml_depth.hpp"
#include "run/config/fields.hpp"

namespace relidar {
namespace {

using namespace config;

/// written in quotes in a TOML file
template <class T>
constexpr bool is_text = std::is_same_v<T, std::string> || std::is_enum_v<T>;

template <class T>
std::string format_setting(const T& value, const SettingValueRange& accepted_values) {
    if constexpr (std::is_enum_v<T>) return accepted_values.choices.at(static_cast<std::size_t>(value));
    else if constexpr (std::is_floating_point_v<T>) return number_text(value);
    else return fmt::format("{}", value);
}

/// Describes the values that a setting of type T accepts, for help and error messages.
/// For example "a number of at least 0", "an integer from 1 to 64", "one of ray, surfel".
template <class T>
std::string describe_range(const SettingValueRange& accepted) {
    if constexpr (std::is_same_v<T, bool>) return "true or false";
    const std::string choices = fmt::format("{}", fmt::join(accepted.choices, ", "));
    if (accepted.several) return fmt::format("some of {}, separated by commas", choices);
    if (!choices.empty()) return fmt::format("one of {}", choices);
    if constexpr (is_text<T>) return "text";

    const std::string kind = std::is_integral_v<T> ? "an integer" : "a number";
    const double unlimited = std::is_integral_v<T> ? kMaxCount : std::numeric_limits<double>::max();
    if (accepted.high >= unlimited)
        return fmt::format("{} {} {:.15g}", kind, accepted.above_low ? "above" : "of at least", accepted.low);
    if (accepted.above_low)
        return fmt::format("{} above {:.15g} and at most {:.15g}", kind, accepted.low, accepted.high);
    return fmt::format("{} from {:.15g} to {:.15g}", kind, accepted.low, accepted.high);
}

/// Parses a finite number within the accepted range. Returns nothing for other text.
template <class T>
std::optional<T> parse_in_range(const std::string& text, const SettingValueRange& accepted_values) {
    T parsed{};
    const char* begin = text.data();
    const char* end = begin + text.size();
    // std::from_chars() does not accept a plus sign.
    if (begin != end && *begin == '+') ++begin;
    const auto [stop, error] = std::from_chars(begin, end, parsed);
    const bool is_number = begin != end && error == std::errc() && stop == end;
    if (!is_number) return std::nullopt;
    if constexpr (std::is_floating_point_v<T>) {
        if (!std::isfinite(parsed)) return std::nullopt;
    }
    const auto number = static_cast<double>(parsed);
    if (number > accepted_values.high || number < accepted_values.low ||
        (accepted_values.above_low && number <= accepted_values.low))
        return std::nullopt;
    return parsed;
}

/// Parses the text of a setting of type T. Returns nothing if the value is not accepted.
template <class T>
std::optional<T> parse_setting(const std::string& text, const SettingValueRange& accepted_values) {
    const std::vector<std::string>& choices = accepted_values.choices;
    const auto is_choice = [&](const std::string& word) {
        return std::ranges::find(choices, word) != choices.end();
    };
    bool is_accepted = true;  // settings without choices are checked below
    if (accepted_values.several) is_accepted = std::ranges::all_of(split_list(text), is_choice);
    else if (!choices.empty()) is_accepted = is_choice(text);
    if (!is_accepted) return std::nullopt;

    if constexpr (std::is_enum_v<T>) {
        // The choices are in the order of the enumerators.
        return static_cast<T>(std::ranges::find(choices, text) - choices.begin());
    } else if constexpr (std::is_same_v<T, std::string>) {
        if (text.find_first_of("\n\r") != std::string::npos) return std::nullopt;
        return text;
    } else if constexpr (std::is_same_v<T, bool>) {
        if (text != "true" && text != "false") return std::nullopt;
        return text == "true";
    } else {
        return parse_in_range<T>(text, accepted_values);
    }
}

struct ParsedValue {
    std::string text;
    std::optional<bool> is_quoted;  ///< only known in a TOML file, because a shell removes quotes
};

std::vector<std::string> list_keys() {
    std::vector<std::string> keys;
    for (const ConfigKey& key : list_config_keys(Config{})) keys.push_back(key.key);
    return keys;
}

std::string unknown_key(const std::string& key) {
    return fmt::format("setting {}: unknown key{}", quote(key),
                       did_you_mean(key, list_keys(), "",
                                    ", expected one of the keys that `relidar list settings --all` prints"));
}

/// Parses a value and stores it in a setting. Text needs quotes in a TOML file, and other
/// values must not have quotes.
/// @throws UsageError if type or range are wrong
template <class T>
void assign_value(T& field, const std::string& key, const SettingValueRange& accepted_values,
                  const ParsedValue& parsed_value) {
    // On the command line, it is not known whether the value had quotes.
    const bool wrong_kind = parsed_value.is_quoted && *parsed_value.is_quoted != is_text<T>;
    const std::optional<T> parsed = parse_setting<T>(parsed_value.text, accepted_values);
    if (wrong_kind || !parsed) {
        const char* hint = "";
        if (wrong_kind) hint = is_text<T> ? " in quotes" : " without quotes";
        fail<UsageError>("setting {}: found \"{}\", expected {}{}", key, quote(parsed_value.text),
                         describe_range<T>(accepted_values), hint);
    }
    field = *parsed;
}

/// Sets the field of a key. The setting `preset` also replaces all other settings.
void apply_setting(Config& config, const std::string& key, const ParsedValue& value) {
    bool is_known_key = false;
    // Visits all settings, because each field has another type.
    visit_settings(config,
                   [&](const char* name, auto& field, const SettingValueRange& accepts, const SettingHelp&) {
                       if (key != name) return;
                       is_known_key = true;
                       assign_value(field, key, accepts, value);
                   });
    if (!is_known_key) throw UsageError(unknown_key(key));
    if (key == "preset") config = make_preset(config.preset);
}

/// Converts a TOML scalar to text, and stores whether it was quoted.
ParsedValue scalar_text(const toml::node& node, const std::string& key) {
    if (const auto* text = node.as_string()) return {text->get(), true};
    if (const auto* integer = node.as_integer()) return {fmt::format("{}", integer->get()), false};
    if (const auto* number = node.as_floating_point()) return {number_text(number->get()), false};
    if (const auto* boolean = node.as_boolean()) return {boolean->get() ? "true" : "false", false};
    std::ostringstream kind;
    kind << node.type();
    fail<UsageError>("setting {}: found a TOML {}, expected a single value", quote(key), kind.str());
}

/// Adds all values of a TOML table to `flat`, with full names such as "table.key".
void flatten(const toml::table& table, const std::string& prefix, std::map<std::string, ParsedValue>& flat) {
    for (const auto& [name, node] : table) {
        const std::string key = prefix + std::string(name.str());
        if (const toml::table* inner = node.as_table()) flatten(*inner, key + ".", flat);
        else flat.emplace(key, scalar_text(node, key));
    }
}

/// Checks that a settings file contains every setting and no unknown key. Files from
/// to_toml() fulfil this.
/// @throws UsageError if a setting is missing or a key is unknown
void check_settings(const std::map<std::string, ParsedValue>& settings) {
    constexpr const char* kAdvice =
        "the run was probably written by another version of relidar, so it must be trained again";
    const std::vector<std::string> keys = list_keys();
    for (const auto& [key, found] : settings)
        if (std::ranges::find(keys, key) == keys.end()) fail<UsageError>("{}; {}", unknown_key(key), kAdvice);
    for (const std::string& key : keys)
        if (!settings.contains(key))
            fail<UsageError>("the setting {} is missing, but the file must contain all settings; {}", key,
                             kAdvice);
}

/// Writes a TOML string in quotes. Escapes quotes, backslashes and control characters.
std::string quote_toml(const std::string& text) {
    std::string result = "\"";
    for (const char c : text) {
        if (c == '"' || c == '\\') result += '\\';
        if (std::iscntrl(static_cast<unsigned char>(c)))
            result += fmt::format("\\u{:04X}", static_cast<unsigned>(static_cast<unsigned char>(c)));
        else result += c;
    }
    return result + '"';
}

/// Reads a TOML file and applies its settings to `config`.
/// @param must_be_complete  true if the file must contain all settings
void read_config_file(Config& config, const std::filesystem::path& path, bool must_be_complete) {
    const std::string text = read_text_file(path);
    check_toml_depth(text, path.string());
    Config result = config;  // changes a copy, so that `config` stays unchanged if an error is thrown
    try {
        const toml::table table = toml::parse(text, path.string());
        std::map<std::string, ParsedValue> settings;
        flatten(table, "", settings);
        if (must_be_complete) check_settings(settings);
        // Applies the preset first, because it would overwrite the other settings.
        if (const auto preset = settings.extract("preset")) apply_setting(result, "preset", preset.mapped());
        for (const auto& [key, found] : settings) apply_setting(result, key, found);
    } catch (const toml::parse_error& error) {
        fail("{}:{}: not valid TOML: {}", path.string(), error.source().begin.line,
             quote(error.description()));
    } catch (const UsageError& error) {
        fail<UsageError>("{}: {}", path.string(), error.what());
    }
    config = std::move(result);
}

/// Returns the settings as TOML text, grouped by table, with a comment for each setting.
std::string format_toml(const Config& config, const std::set<std::string>& left_out_keys) {
    std::string text, table;
    visit_settings(config, [&](const std::string& key, const auto& field, const SettingValueRange& accepts,
                               const SettingHelp& help) {
        using T = std::decay_t<decltype(field)>;
        if (left_out_keys.contains(key)) return;
        // The part of a key before the dot is its TOML table.
        const std::size_t dot = key.find('.');
        const std::string key_table = dot == std::string::npos ? "" : key.substr(0, dot);
        const std::string name = key.substr(dot + 1);  // npos + 1 is 0
        if (key_table != table) text += fmt::format("\n[{}]\n", key_table);
        table = key_table;
        const std::string value = format_setting(field, accepts);
        text += fmt::format("# {} ({})\n{} = {}\n", help.text, describe_range<T>(accepts), name,
                            is_text<T> ? quote_toml(value) : value);
    });
    return text;
}

}  // namespace

/// Returns key, value and help of each setting, in the order of the TOML file.
std::vector<ConfigKey> list_config_keys(const Config& config) {
    std::vector<ConfigKey> keys;
    visit_settings(config, [&](const char* key, const auto& field, const SettingValueRange& accepts,
                               const SettingHelp& help) {
        using T = std::decay_t<decltype(field)>;
        keys.push_back({key, format_setting(field, accepts),
                        fmt::format("{} ({})", help.text, describe_range<T>(accepts)), help.expert});
    });
    return keys;
}

void set_value(Config& config, const std::string& key, const std::string& value) {
    apply_setting(config, key, {value, std::nullopt});
}

void apply_file(Config& config, const std::filesystem::path& path) { read_config_file(config, path, false); }

/// Loads a file that must contain all settings. Errors are DataErrors, because the file
/// belongs to a run and was not written by the user.
Config load_settings(const std::filesystem::path& path) {
    Config config;
    try {
        read_config_file(config, path, true);
    } catch (const UsageError& error) {
        throw DataError(error.what());
    }
    return config;
}

std::string to_toml(const Config& config) {
    return "# All settings of a relidar run. `relidar train --config` can read this file.\n" +
           format_toml(config, {});
}

/// Returns the settings as TOML text. Leaves out expert settings that equal the preset.
std::string to_short_toml(const Config& config) {
    std::set<std::string> left_out;
    // Both lists contain all settings in the same order.
    const std::vector<ConfigKey> keys = list_config_keys(config),
                                 preset = list_config_keys(make_preset(config.preset));
    for (std::size_t i = 0; i < keys.size(); ++i)
        if (keys[i].expert && keys[i].value == preset[i].value) left_out.insert(keys[i].key);
    return format_toml(config, left_out) +
           fmt::format(
               "\n"
               "# {} expert settings with the values of the preset are not shown; `relidar list settings "
               "--all` shows them\n",
               left_out.size());
}

}  // namespace relidar
