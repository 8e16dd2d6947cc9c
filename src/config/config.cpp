// SPDX-License-Identifier: Apache-2.0
// Settings from text, TOML and back, all by walking the one table of fields.hpp. TOML tables are the first part of a key.
#include <relidar/config.hpp>

#include <algorithm>
#include <array>
#include <cctype>
#include <sstream>

#include <fmt/format.h>
#define TOML_EXCEPTIONS 1
#include <toml++/toml.h>

#include "config/field_text.hpp"
#include "core/files.hpp"
#include "core/number_text.hpp"
#include <relidar/channels.hpp>
#include <relidar/stages/accel.hpp>
#include <relidar/stages/backward.hpp>
#include <relidar/error.hpp>
#include <relidar/stages/toml_depth.hpp>
#include <relidar/stages/traversal.hpp>

namespace relidar {
namespace {

using config_detail::Accepts;
using config_detail::describe;
using config_detail::from_text;
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
    visit(static_cast<const Config&>(Config{}), [&](const char* key, const auto&, const Accepts&, const char*) { keys.emplace_back(key); });
    return keys;
}

template <class T>
void assign(T& field, const std::string& key, const Accepts& accepts, const Found& found) {
    const bool wrong_kind = found.quotes == (is_text<T> ? Found::Quotes::no : Found::Quotes::yes);
    if (wrong_kind || !from_text(found.text, accepts, field)) {
        const char* hint = wrong_kind && is_text<T> ? " in quotes" : wrong_kind ? " without quotes" : "";
        throw UsageError(fmt::format("setting {}: found \"{}\", expected {}{}", key, excerpt(found.text), describe<T>(accepts), hint));
    }
}

void set_found(Config& config, const std::string& key, const Found& found) {
    bool known = false;
    visit(config, [&](const char* name, auto& field, const Accepts& accepts, const char*) {
        if (known || key != name) return;
        known = true;
        assign(field, key, accepts, found);
    });
    if (!known)
        throw UsageError(fmt::format("setting {}: unknown key{}", excerpt(key),
                                     did_you_mean(key, all_keys(), "", ", expected one that `relidar config` lists")));
    if (key == "preset") config = make_preset(config.preset);
}

/// Channels had a key each in files of earlier versions. @return whether it was one
bool take_former_key(Config& config, const std::string& key, const Found& found) {
    const std::string channel = key == "render.normals" ? "normal" : key == "render.spread" ? "spread" : key == "render.seen" ? "seen" : "";
    if (channel.empty()) return false;
    bool is_wanted = false;
    assign(is_wanted, key, {}, found);
    std::string& channels = config.render.channels;
    if (is_wanted) channels += (channels.empty() ? "" : ",") + channel;
    return true;
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

void set_table(Config& config, const toml::table& table, const std::string& prefix) {
    for (const auto& [name, node] : table) {
        const std::string key = prefix + std::string(name.str());
        if (const toml::table* inner = node.as_table()) set_table(config, *inner, key + ".");
        else if (key != "preset" && !take_former_key(config, key, found_in(node, key))) set_found(config, key, found_in(node, key));
    }
}

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
    visit(config, [&](const char* key, const auto& field, const Accepts& accepts, const char* help) {
        using T = std::decay_t<decltype(field)>;
        keys.push_back({key, to_text(field, accepts), fmt::format("{} ({})", help, describe<T>(accepts))});
    });
    return keys;
}

void set_key(Config& config, const std::string& key, const std::string& value) { set_found(config, key, {value, Found::Quotes::unknown}); }

void load_config(Config& config, const std::filesystem::path& path) {
    const std::string text = read_file(path);
    check_toml_depth(text, path.string());
    Config result = config;   // all or nothing
    try {
        const toml::table table = toml::parse(text, path.string());
        if (const toml::node* preset = table.get("preset")) set_found(result, "preset", found_in(*preset, "preset"));
        set_table(result, table, "");
    } catch (const toml::parse_error& error) {
        throw DataError(fmt::format("{}:{}: not valid TOML: {}", path.string(), error.source().begin.line, excerpt(error.description())));
    } catch (const UsageError& error) {
        throw UsageError(fmt::format("{}: {}", path.string(), error.what()));
    }
    config = std::move(result);
}

std::string to_toml(const Config& config) {
    std::string text = "# Settings of a relidar run: every value used. Read back by `relidar train --config`.\n";
    std::string table;
    visit(config, [&](const std::string& key, const auto& field, const Accepts& accepts, const char* help) {
        using T = std::decay_t<decltype(field)>;
        const std::size_t dot = key.find('.');
        const std::string key_table = dot == std::string::npos ? "" : key.substr(0, dot);
        if (key_table != table) text += fmt::format("\n[{}]\n", key_table);
        table = key_table;
        text += fmt::format("# {} ({})\n{} = {}\n", help, describe<T>(accepts), key.substr(dot + 1), toml_value(field, accepts));
    });
    return text;
}

AccelOptions accel_options(const Config& config) {
    AccelOptions options;
    if (config.trace.proxy == "triangles") options.proxy = Proxy::triangles;
    if (config.trace.proxy == "boxes") options.proxy = Proxy::boxes;
    options.rebuild_every = config.trace.rebuild_every;
    options.rebuild_growth = static_cast<float>(config.trace.rebuild_growth);
    return options;
}

TraceOptions trace_options(const Config& config) {
    TraceOptions options;
    options.chunk = config.trace.chunk;
    if (config.trace.walk == "lane") options.walk = Walk::lane;
    if (config.trace.walk == "subgroup") options.walk = Walk::subgroup;
    return options;
}

TraceOptions training_trace_options(const Config& config) {
    TraceOptions options = trace_options(config);
    options.geometry = config.loss.uses_geometry();
    if (config.loss.likelihood > 0.0f) options.likelihood = {config.loss.likelihood_scale_m, config.loss.likelihood_scale_share};
    return options;
}

TraceOptions rendering_trace_options(const Config& config) {
    TraceOptions options = trace_options(config);
    options.geometry = std::ranges::any_of(wanted_channels(config.render.channels), &ChannelInfo::needs_normals);
    if (config.render.range == "mode") options.mode_gap_m = static_cast<float>(config.sensor.return_separation_m);
    return options;
}

BackwardOptions backward_options(const Config& config) {
    BackwardOptions options;
    if (config.train.gradient_sums == "atomics") options.reduction = Reduction::atomics;
    if (config.train.gradient_sums == "gather" || config.train.deterministic) options.reduction = Reduction::gather;
    options.hits_per_ray = static_cast<std::uint32_t>(config.train.gather_hits);
    return options;
}

}  // namespace relidar
