// SPDX-License-Identifier: Apache-2.0
// Settings from text, TOML and back, all by walking the one table of fields.hpp. TOML tables are the first part of a key.
#include <relidar/config.hpp>

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

#include "config/field_text.hpp"
#include "config/former_keys.hpp"
#include "core/files.hpp"
#include "core/number_text.hpp"
#include <relidar/error.hpp>
#include <relidar/stages/toml_depth.hpp>

namespace relidar {
namespace {

using config_detail::Accepts;
using config_detail::added_keys;
using config_detail::describe;
using config_detail::find_moved;
using config_detail::find_removed;
using config_detail::from_text;
using config_detail::Help;
using config_detail::is_text;
using config_detail::to_text;
using config_detail::visit;

/// A value as it was found: text, and whether it stood in quotes (a TOML file says; a command line does not).
struct Found {
    std::string text;
    enum class Quotes { unknown, yes, no } quotes = Quotes::unknown;
};

std::vector<std::string> all_keys() {
    std::vector<std::string> keys;
    visit(static_cast<const Config&>(Config{}), [&](const char* key, const auto&, const Accepts&, const Help&) { keys.emplace_back(key); });
    return keys;
}

template <class T>
void assign(T& field, const std::string& key, const Accepts& accepts, const Found& found) {
    const bool is_boolean = found.quotes == Found::Quotes::no && (found.text == "true" || found.text == "false");
    const bool was_boolean = std::is_enum_v<T> && is_boolean;   // a setting that earlier versions wrote without quotes
    const bool wrong_kind = !was_boolean && found.quotes == (is_text<T> ? Found::Quotes::no : Found::Quotes::yes);
    if (wrong_kind || !from_text(found.text, accepts, field)) {
        const char* hint = wrong_kind && is_text<T> ? " in quotes" : wrong_kind ? " without quotes" : "";
        throw UsageError(fmt::format("setting {}: found \"{}\", expected {}{}", key, excerpt(found.text), describe<T>(accepts), hint));
    }
}

void set_found(Config& config, const std::string& key, const Found& found) {
    bool known = false;
    visit(config, [&](const char* name, auto& field, const Accepts& accepts, const Help&) {
        if (known || key != name) return;
        known = true;
        assign(field, key, accepts, found);
    });
    if (const auto* removed = find_removed(key))
        throw UsageError(fmt::format("setting {}: it was removed: {}", key, removed->why));
    if (const auto* moved = find_moved(key)) throw UsageError(fmt::format("setting {}: it was removed: {} says it now", key, moved->to));
    if (!known)
        throw UsageError(fmt::format("setting {}: unknown key{}", excerpt(key),
                                     did_you_mean(key, all_keys(), "", ", expected one that `relidar config` lists")));
    if (key == "preset") config = make_preset(config.preset);
}

/// A TOML scalar as text.
Found found_in(const toml::node& node, const std::string& key) {
    if (const auto* text = node.as_string()) return {text->get(), Found::Quotes::yes};
    if (const auto* integer = node.as_integer()) return {fmt::format("{}", integer->get()), Found::Quotes::no};
    if (const auto* number = node.as_floating_point()) return {number_text(number->get()), Found::Quotes::no};
    if (const auto* boolean = node.as_boolean()) return {boolean->get() ? "true" : "false", Found::Quotes::no};
    std::ostringstream kind;
    kind << node.type();
    throw UsageError(fmt::format("setting {}: found a TOML {}, expected a single value", excerpt(key), kind.str()));
}

/// All of a table but the preset, in the order of the alphabet.
void flatten(const toml::table& table, const std::string& prefix, std::map<std::string, Found>& settings) {
    for (const auto& [name, node] : table) {
        const std::string key = prefix + std::string(name.str());
        if (const toml::table* inner = node.as_table()) flatten(*inner, key + ".", settings);
        else if (key != "preset") settings.emplace(key, found_in(node, key));
    }
}

/// Takes a setting of an earlier version over. @return whether it is one
bool take_former(Config& config, const std::string& key, const std::string& value) {
    if (find_removed(key)) return true;
    const auto* moved = find_moved(key);
    if (!moved) return false;
    try {
        moved->take(config, value);
    } catch (const UsageError& error) {
        throw UsageError(fmt::format("setting {}: {}", key, error.what()));
    }
    return true;
}

/// Sets all of them. @return those of an earlier version, each of which says what the program does now @throws UsageError
std::vector<std::string> take_all(Config& config, const std::map<std::string, Found>& settings) {
    std::vector<std::string> former;
    for (const auto& [key, found] : settings) {
        if (take_former(config, key, found.text)) former.push_back(key);
        else set_found(config, key, found);
    }
    for (const std::string& key : former)
        if (const auto* removed = find_removed(key)) check_removed(config, *removed, settings.at(key).text);
    return former;
}

/// Whether a file is that of a run, which names every value there was when it was written; other files name those that somebody chose.
bool names_all(const std::map<std::string, Found>& settings) { return settings.size() > all_keys().size() / 2; }

/// Text in TOML's basic quotes.
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
std::string toml_value(const T& value, const Accepts& accepts) {
    const std::string text = to_text(value, accepts);
    return is_text<T> ? quoted(text) : text;
}

}  // namespace

std::vector<ConfigKey> config_keys(const Config& config) {
    std::vector<ConfigKey> keys;
    visit(config, [&](const char* key, const auto& field, const Accepts& accepts, const Help& help) {
        using T = std::decay_t<decltype(field)>;
        keys.push_back({key, to_text(field, accepts), fmt::format("{} ({})", help.text, describe<T>(accepts)), help.expert});
    });
    return keys;
}

void set_key(Config& config, const std::string& key, const std::string& value) { set_found(config, key, {value, Found::Quotes::unknown}); }

void load_config(Config& config, const std::filesystem::path& path, const std::function<void(const std::string&)>& note) {
    const std::string text = read_text(path);
    check_toml_depth(text, path.string());
    Config result = config;   // all or nothing
    std::vector<std::string> former;
    try {
        const toml::table table = toml::parse(text, path.string());
        if (const toml::node* preset = table.get("preset")) set_found(result, "preset", found_in(*preset, "preset"));
        std::map<std::string, Found> settings;
        flatten(table, "", settings);
        if (names_all(settings))
            for (const auto& [key, before] : added_keys()) settings.try_emplace(key, Found{before, Found::Quotes::no});
        former = take_all(result, settings);
    } catch (const toml::parse_error& error) {
        throw DataError(fmt::format("{}:{}: not valid TOML: {}", path.string(), error.source().begin.line, excerpt(error.description())));
    } catch (const UsageError& error) {
        throw UsageError(fmt::format("{}: {}", path.string(), error.what()));
    }
    config = std::move(result);
    if (!note || former.empty()) return;
    constexpr std::size_t kNamed = 3;
    const std::size_t n = former.size();
    former.resize(std::min(n, kNamed));
    note(fmt::format("{}: {} settings of an earlier version, whose values are what the program does now: {}{}", path.string(), n,
                     fmt::join(former, ", "), n > kNamed ? fmt::format(" and {} more", n - kNamed) : ""));
}

void update_settings(std::map<std::string, std::string>& settings) {
    Config config;
    std::map<std::string, Found> found;
    for (const auto& [key, value] : settings)
        if (key != "preset") found.emplace(key, Found{value, Found::Quotes::unknown});
    std::map<std::string, std::string> successors;
    for (const std::string& key : take_all(config, found)) {
        if (const auto* moved = find_moved(key)) successors.emplace(moved->to, "");
        settings.erase(key);
    }
    for (const ConfigKey& key : config_keys(config))
        if (successors.contains(key.key)) settings[key.key] = key.value;
    for (const auto& [key, before] : added_keys()) settings.try_emplace(key, before);
}

namespace {

/// Settings with a comment each, by table. @param is_shown  (key)
template <class Shown>
std::string toml_of(const Config& config, const Shown& is_shown) {
    std::string text, table;
    visit(config, [&](const std::string& key, const auto& field, const Accepts& accepts, const Help& help) {
        using T = std::decay_t<decltype(field)>;
        if (!is_shown(key)) return;
        const std::size_t dot = key.find('.');
        const std::string key_table = dot == std::string::npos ? "" : key.substr(0, dot);
        if (key_table != table) text += fmt::format("\n[{}]\n", key_table);
        table = key_table;
        text += fmt::format("# {} ({})\n{} = {}\n", help.text, describe<T>(accepts), key.substr(dot + 1), toml_value(field, accepts));
    });
    return text;
}

}  // namespace

std::string to_toml(const Config& config) {
    return "# Settings of a relidar run: every value used. Read back by `relidar train --config`.\n" +
           toml_of(config, [](const std::string&) { return true; });
}

std::string to_short_toml(const Config& config) {
    std::set<std::string> left_out;
    const std::vector<ConfigKey> keys = config_keys(config), preset = config_keys(make_preset(config.preset));
    for (std::size_t i = 0; i < keys.size(); ++i)
        if (keys[i].expert && keys[i].value == preset[i].value) left_out.insert(keys[i].key);
    return toml_of(config, [&](const std::string& key) { return !left_out.contains(key); }) +
           fmt::format("\n# {} expert settings, all as the preset has them, are not shown: relidar config --all\n", left_out.size());
}

}  // namespace relidar
