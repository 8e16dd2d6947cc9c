// SPDX-License-Identifier: Apache-2.0
#include "options.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <CLI/CLI.hpp>

#include <relidar/base/error.hpp>
#include <relidar/diff/first_use.hpp>
#include <relidar/log/channels.hpp>
#include <relidar/simulate/weather.hpp>
#include <relidar/train/train.hpp>
#include "console.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

/// Returns the number in a text. Returns no value if the text is not a number.
template <class T>
std::optional<T> parse(const std::string& text) {
    T value{};
    const char* begin = text.data() + (!text.empty() && text.front() == '+' ? 1 : 0);
    const char* end = text.data() + text.size();
    const auto [stop, error] = std::from_chars(begin, end, value);
    return begin != end && error == std::errc() && stop == end ? std::optional(value) : std::nullopt;
}

}  // namespace

void add_device_options(CLI::App& command, DeviceChoice& choice) {
    command
        .add_option("--device", choice.index,
                    "number of the Vulkan device in `relidar list devices` (default: a GPU with ray query, "
                    "else any GPU, else a CPU device)")
        ->type_name("N");
    command
        .add_option("--traversal", choice.traversal,
                    "method to trace rays: auto, ray_query or software; auto uses ray_query if the GPU "
                    "supports it, else software (default: auto)")
        ->type_name("HOW");
}

DeviceOptions make_device_options(const DeviceChoice& choice) {
    DeviceOptions options;
    if (choice.index < -1)
        throw UsageError(fmt::format(
            "--device: found {}; expected a device number from `relidar list devices`", choice.index));
    options.index = choice.index;
    options.traversal = find_traversal(choice.traversal);
    set_first_use({check_device_at_first_use, note});
    return apply_environment_variables(options);
}

std::vector<std::string> make_device_arguments(const DeviceChoice& choice) {
    std::vector<std::string> words;
    if (choice.index >= 0) words.insert(words.end(), {"--device", fmt::format("{}", choice.index)});
    if (choice.traversal != "auto") words.insert(words.end(), {"--traversal", choice.traversal});
    return words;
}

void add_channels_option(CLI::App& command, std::optional<std::string>& channels) {
    command
        .add_option(
            "--channels", channels,
            fmt::format(
                "additional channels of scans, separated by commas: {}; short for --set render.channels=LIST",
                fmt::join(list_optional_channels(), ", ")))
        ->type_name("LIST");
}

void add_weather_option(CLI::App& command, std::string& weather, const std::string& description) {
    command
        .add_option(
            "--weather", weather,
            fmt::format(
                "{}; applies to {} (default: clear); the channel `source` holds the cause of each point",
                make_weather_help(), description))
        ->type_name("WEATHER");
}

void add_set_option(CLI::App& command, std::vector<std::string>& sets) {
    command
        .add_option("--set", sets,
                    "change one setting, for example loss.depth=0.2; repeatable; `relidar list settings` "
                    "lists all keys")
        ->type_name("KEY=VALUE")
        ->type_size(1)
        ->allow_extra_args(false);
}

void add_settings_options(CLI::App& command, Settings& settings) {
    command
        .add_option("--preset", settings.preset,
                    "settings to start from: default, quick (trains in minutes on a CPU), paper (as "
                    "described in the paper) or released (as in the authors' code)")
        ->type_name("NAME");
    command.add_option("--config", settings.file, "TOML file with settings that replace those of the preset")
        ->type_name("FILE");
    add_set_option(command, settings.sets);
}

Config resolve_settings(const Settings& settings) {
    Config config = make_preset(settings.preset);
    if (!settings.file.empty()) load_config(config, settings.file);
    apply_setting_texts(config, settings.sets);
    return config;
}

void apply_setting_texts(Config& config, const std::vector<std::string>& sets) {
    for (const std::string& set : sets) {
        const std::size_t equals = set.find('=');
        if (equals == std::string::npos || equals == 0)
            throw UsageError(
                fmt::format("--set: found \"{}\"; expected KEY=VALUE, for example loss.depth=0.2", set));
        set_config_value(config, set.substr(0, equals), set.substr(equals + 1));
    }
}

std::vector<std::string> list_rendering_settings() {
    return {"dataset.min_range_m",
            "dataset.max_range_m",
            "sensor.grid",
            "sensor.grid_method",
            "sensor.rolling_shutter",
            "sensor.sub_rays",
            "sensor.divergence_mrad",
            "sensor.returns",
            "sensor.return_separation_m",
            "image.",
            "refine.enabled",
            "render.",
            "trace."};
}

void check_setting_names(const std::vector<std::string>& sets, const std::vector<std::string>& used,
                         const std::string& command) {
    Config scratch;
    for (const std::string& set : sets) {
        // Throws an error if the key or the value is invalid. The result is not used.
        apply_setting_texts(scratch, {set});
        const std::string key = set.substr(0, set.find('='));
        const bool is_used = std::ranges::any_of(used, [&](const std::string& name) {
            return name.ends_with('.') ? key.starts_with(name) : key == name;
        });
        if (is_used) continue;
        throw UsageError(
            fmt::format("--set: the setting {} has no effect in `relidar {}`; expected {}", key, command,
                        used.empty() ? "no setting" : fmt::format("one of {}", fmt::join(used, ", "))));
    }
}

void add_log_part_options(CLI::App& command, LogPart& part) {
    command
        .add_option("--frames", part.frames,
                    "frames of the log to read, first:end, by the dataset's frame numbers (default: all)")
        ->type_name("A:B");
    command
        .add_option("--sequence", part.sequence,
                    "name of the drive if the dataset contains several (default: the first)")
        ->type_name("NAME");
}

void apply_log_part(Config& config, const LogPart& part) {
    if (!part.sequence.empty()) config.dataset.sequence = part.sequence;
    if (part.frames.empty()) return;
    const FrameRange range = parse_frames(part.frames);
    config.dataset.frames_begin = range.begin;
    config.dataset.frames_end = range.end;
}

FrameRange parse_frames(const std::string& text) {
    const std::size_t colon = text.find(':');
    const std::string begin = text.substr(0, colon),
                      end = colon == std::string::npos ? "" : text.substr(colon + 1);
    const int first = begin.empty() ? 0 : parse<int>(begin).value_or(-1),
              last = end.empty() ? -1 : parse<int>(end).value_or(-1);
    if (colon == std::string::npos || first < 0 || (!end.empty() && last < 0)) {
        throw UsageError(fmt::format(
            "--frames: found \"{}\"; expected FIRST:END without frame END, for example 0:50", text));
    }
    if (last != -1 && first >= last)
        throw UsageError(
            fmt::format("--frames: found the empty range \"{}\"; expected FIRST:END with FIRST < END", text));
    return {first, last};
}

void note_frames_beyond(const FrameRange& range, int last, const std::string& location) {
    if (range.end > last + 1)
        note(fmt::format("frames {}:{}: {} ends with frame {}; the missing frames are skipped", range.begin,
                         range.end, location, last));
}

std::vector<double> parse_list(const std::string& option, const std::string& text) {
    std::vector<double> numbers;
    for (const std::string& typed : split_text(text, ',')) {
        const std::string word = remove_blanks(typed);
        const std::optional<double> value = parse<double>(word);
        if (!value || !std::isfinite(*value))
            throw UsageError(fmt::format("{}: found \"{}\" in \"{}\", expected numbers separated by commas",
                                         option, word, text));
        numbers.push_back(*value);
    }
    return numbers;
}

std::vector<std::string> split_text(const std::string& text, char separator) {
    std::vector<std::string> words{""};
    for (const char c : text) {
        if (c == separator) words.emplace_back();
        else words.back() += c;
    }
    return words;
}

std::string remove_blanks(const std::string& text) {
    const std::size_t begin = text.find_first_not_of(" \t"), end = text.find_last_not_of(" \t");
    return begin == std::string::npos ? "" : text.substr(begin, end - begin + 1);
}

std::string make_absolute_path(const std::string& path) {
    if (path.empty()) return path;
    const std::string clean = fs::absolute(path).lexically_normal().string();
    return clean.size() > 1 && clean.back() == '/' ? clean.substr(0, clean.size() - 1) : clean;
}

Sequence load_dataset(const Config& config, bool quiet, int max_scans) {
    Progress progress(quiet);
    Sequence sequence = load_log(config, make_progress(progress), max_scans);
    if (!sequence.frames.empty())
        note_frames_beyond({config.dataset.frames_begin, config.dataset.frames_end},
                           sequence.frames.back().index, sequence.source);
    if (const ScanMemoryUse use = get_scan_memory_use(); use.in_file > 0 && !quiet)
        note(
            fmt::format("{} of scan data are kept in memory and {} in a temporary file in {}; the setting "
                        "dataset.memory_mib is the limit",
                        format_byte_size(use.in_memory), format_byte_size(use.in_file),
                        fs::temp_directory_path().string()));
    return sequence;
}

}  // namespace relidar::cli
