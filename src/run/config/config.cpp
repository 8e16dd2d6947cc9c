// SPDX-License-Identifier: Apache-2.0
// Reads settings from text and TOML files, and writes them as TOML. All functions use the
// table of settings in fields.hpp. The first part of a setting's name is its TOML table.
#include <relidar/run/config.hpp>

#include <algorithm>
#include <array>
#include <cctype>
#include <map>
#include <set>
#include <sstream>

#include <fmt/format.h>
#include <fmt/ranges.h>
#define TOML_EXCEPTIONS 1
#include <toml++/toml.h>

#include <relidar/base/error.hpp>
#include "base/files.hpp"
#include "base/number_text.hpp"
#include "base/toml_depth.hpp"
#include "run/config/field_text.hpp"

namespace relidar {
namespace {

using config_detail::Accepts;
using config_detail::describe;
using config_detail::from_text;
using config_detail::Help;
using config_detail::is_text;
using config_detail::to_text;
using config_detail::visit;

/// Value of a setting as text. A TOML file shows whether the value was in quotes. On the
/// command line this is unknown, because the shell removes quotes.
struct ParsedValue {
    std::string text;
    enum class Quotes { unknown, yes, no } quotes = Quotes::unknown;
};

std::vector<std::string> list_all_keys() {
    std::vector<std::string> keys;
    visit(static_cast<const Config&>(Config{}),
          [&](const char* key, const auto&, const Accepts&, const Help&) { keys.emplace_back(key); });
    return keys;
}

std::string make_unknown_key_message(const std::string& key) {
    return fmt::format("setting {}: unknown key{}", make_excerpt(key),
                       suggest_name(key, list_all_keys(), "",
                                    ", expected one of the keys that `relidar list settings --all` prints"));
}

template <class T>
void assign(T& field, const std::string& key, const Accepts& accepts, const ParsedValue& value) {
    const bool wrong_kind = value.quotes == (is_text<T> ? ParsedValue::Quotes::no : ParsedValue::Quotes::yes);
    const std::optional<T> parsed = from_text<T>(value.text, accepts);
    if (wrong_kind || !parsed) {
        const char* hint = wrong_kind && is_text<T> ? " in quotes" : wrong_kind ? " without quotes" : "";
        throw UsageError(fmt::format("setting {}: found \"{}\", expected {}{}", key, make_excerpt(value.text),
                                     describe<T>(accepts), hint));
    }
    field = *parsed;
}

void apply_setting(Config& config, const std::string& key, const ParsedValue& value) {
    bool is_known = false;
    visit(config, [&](const char* name, auto& field, const Accepts& accepts, const Help&) {
        if (is_known || key != name) return;
        is_known = true;
        assign(field, key, accepts, value);
    });
    if (!is_known) throw UsageError(make_unknown_key_message(key));
    if (key == "preset") config = make_preset(config.preset);
}

/// Converts a TOML scalar to text.
ParsedValue parse_scalar(const toml::node& node, const std::string& key) {
    if (const auto* text = node.as_string()) return {text->get(), ParsedValue::Quotes::yes};
    if (const auto* integer = node.as_integer())
        return {fmt::format("{}", integer->get()), ParsedValue::Quotes::no};
    if (const auto* number = node.as_floating_point())
        return {format_number_text(number->get()), ParsedValue::Quotes::no};
    if (const auto* boolean = node.as_boolean())
        return {boolean->get() ? "true" : "false", ParsedValue::Quotes::no};
    std::ostringstream kind;
    kind << node.type();
    throw UsageError(
        fmt::format("setting {}: found a TOML {}, expected a single value", make_excerpt(key), kind.str()));
}

/// Adds all values of a TOML table and its nested tables to `settings`. The keys are full
/// names such as "table.key".
void flatten_table(const toml::table& table, const std::string& prefix,
                   std::map<std::string, ParsedValue>& settings) {
    for (const auto& [name, node] : table) {
        const std::string key = prefix + std::string(name.str());
        if (const toml::table* inner = node.as_table()) flatten_table(*inner, key + ".", settings);
        else settings.emplace(key, parse_scalar(node, key));
    }
}

/// Checks that a settings file contains every setting and no unknown key, like all files
/// that to_toml() writes.
/// @throws UsageError if a setting is missing or a key is unknown
void check_complete(const std::map<std::string, ParsedValue>& settings) {
    constexpr const char* kAdvice = "a run that another version of relidar has written must be trained again";
    const std::vector<std::string> keys = list_all_keys();
    for (const auto& [key, found] : settings)
        if (std::ranges::find(keys, key) == keys.end())
            throw UsageError(fmt::format("{}; {}", make_unknown_key_message(key), kAdvice));
    for (const std::string& key : keys)
        if (!settings.contains(key))
            throw UsageError(fmt::format("the setting {} is missing, expected a value for every setting; {}",
                                         key, kAdvice));
}

/// Returns text as a TOML string, with quotes and escaped characters.
std::string quoted(const std::string& text) {
    std::string result = "\"";
    for (const char c : text) {
        if (c == '"' || c == '\\') result += '\\';
        if (std::iscntrl(static_cast<unsigned char>(c)))
            result += fmt::format("\\u{:04X}", static_cast<unsigned>(static_cast<unsigned char>(c)));
        else result += c;
    }
    return result + '"';
}

template <class T>
std::string format_toml_value(const T& value, const Accepts& accepts) {
    const std::string text = to_text(value, accepts);
    return is_text<T> ? quoted(text) : text;
}

}  // namespace

std::vector<ConfigKey> list_config_keys(const Config& config) {
    std::vector<ConfigKey> keys;
    visit(config, [&](const char* key, const auto& field, const Accepts& accepts, const Help& help) {
        using T = std::decay_t<decltype(field)>;
        keys.push_back({key, to_text(field, accepts), fmt::format("{} ({})", help.text, describe<T>(accepts)),
                        help.expert});
    });
    return keys;
}

void set_config_value(Config& config, const std::string& key, const std::string& value) {
    apply_setting(config, key, {value, ParsedValue::Quotes::unknown});
}

namespace {

/// Reads a TOML file and applies its settings to `config`.
/// @param check  function that checks the settings of the file before they are applied
template <class Check>
void read_config(Config& config, const std::filesystem::path& path, const Check& check) {
    const std::string text = read_text(path);
    check_toml_depth(text, path.string());
    Config result = config;  // changes a copy, so that `config` stays unchanged if an error is thrown
    try {
        const toml::table table = toml::parse(text, path.string());
        std::map<std::string, ParsedValue> settings;
        flatten_table(table, "", settings);
        check(settings);
        if (const auto preset = settings.extract("preset")) apply_setting(result, "preset", preset.mapped());
        for (const auto& [key, found] : settings) apply_setting(result, key, found);
    } catch (const toml::parse_error& error) {
        throw DataError(fmt::format("{}:{}: not valid TOML: {}", path.string(), error.source().begin.line,
                                    make_excerpt(error.description())));
    } catch (const UsageError& error) {
        throw UsageError(fmt::format("{}: {}", path.string(), error.what()));
    }
    config = std::move(result);
}

}  // namespace

void load_config(Config& config, const std::filesystem::path& path) {
    read_config(config, path, [](const std::map<std::string, ParsedValue>&) {});
}

Config load_saved_config(const std::filesystem::path& path) {
    Config config;
    try {
        read_config(config, path, check_complete);
    } catch (const UsageError& error) {
        throw DataError(error.what());
    }
    return config;
}

namespace {

/// Returns the settings as TOML text, grouped by table, with a comment for each setting.
/// @param is_shown  function that returns true for the keys to include
template <class Shown>
std::string format_toml(const Config& config, const Shown& is_shown) {
    std::string text, table;
    visit(config, [&](const std::string& key, const auto& field, const Accepts& accepts, const Help& help) {
        using T = std::decay_t<decltype(field)>;
        if (!is_shown(key)) return;
        const std::size_t dot = key.find('.');
        const std::string key_table = dot == std::string::npos ? "" : key.substr(0, dot);
        if (key_table != table) text += fmt::format("\n[{}]\n", key_table);
        table = key_table;
        text += fmt::format("# {} ({})\n{} = {}\n", help.text, describe<T>(accepts), key.substr(dot + 1),
                            format_toml_value(field, accepts));
    });
    return text;
}

}  // namespace

std::string to_toml(const Config& config) {
    return "# All settings of a relidar run. `relidar train --config` can read this file.\n" +
           format_toml(config, [](const std::string&) { return true; });
}

std::string to_toml_without_defaults(const Config& config) {
    std::set<std::string> left_out;
    const std::vector<ConfigKey> keys = list_config_keys(config),
                                 preset = list_config_keys(make_preset(config.preset));
    for (std::size_t i = 0; i < keys.size(); ++i)
        if (keys[i].expert && keys[i].value == preset[i].value) left_out.insert(keys[i].key);
    return format_toml(config, [&](const std::string& key) { return !left_out.contains(key); }) +
           fmt::format(
               "\n"
               "# {} expert settings with the values of the preset are not shown; `relidar list "
               "settings --all` shows them\n",
               left_out.size());
}

}  // namespace relidar
