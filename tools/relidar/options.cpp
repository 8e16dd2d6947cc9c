// SPDX-License-Identifier: Apache-2.0
#include "options.hpp"
#include "base/fail.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/diff/first_use.hpp>
#include <relidar/log/channels.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/simulate/weather.hpp>
#include "console.hpp"

namespace relidar::cli {
namespace {

namespace fs = std::filesystem;

/// Returns no value unless the complete text is a number. A leading + is allowed, which
/// std::from_chars() rejects.
template <class T>
std::optional<T> parse_number(const std::string& text) {
    T value{};
    const char* begin = text.data() + (text.starts_with('+') ? 1 : 0);
    const char* end = text.data() + text.size();
    const auto [stop, error] = std::from_chars(begin, end, value);
    if (begin == end || error != std::errc() || stop != end) return std::nullopt;
    return value;
}

}  // namespace

void add_device_options(CLI::App& command, DeviceCommandOptions& device_choice) {
    add_option(command, "--device N", device_choice.index,
               "number of the Vulkan device in `relidar list devices` (default: a GPU with ray query, else "
               "any GPU, else a CPU device)");
    add_option(command, "--traversal HOW", device_choice.traversal,
               "method to trace rays: auto, ray_query or software; auto uses ray_query if the GPU supports "
               "it, else software (default: auto)");
}

void add_quiet_option(CLI::App& command, bool& quiet) {
    command.add_flag("--quiet", quiet, "print warnings and errors only")->each([](const std::string& value) {
        set_quiet(value != "false");
    });
}

DeviceOptions to_device_options(const DeviceCommandOptions& device_choice) {
    DeviceOptions options;
    if (device_choice.index < -1)
        fail<UsageError>("--device: found {}; expected a device number from `relidar list devices`",
                         device_choice.index);
    options.index = device_choice.index;
    options.traversal = parse_backend(device_choice.traversal);
    // The library tests a device when this machine opens it for the first time.
    set_open_callbacks({test_device, print_warning});
    return apply_environment(options);
}

std::string resume_command(const std::string& command, const std::string& run,
                           const DeviceCommandOptions& device_choice) {
    std::string text = fmt::format("relidar {} --resume {}", command, quote_for_shell(run));
    if (device_choice.index >= 0) text += fmt::format(" --device {}", device_choice.index);
    if (device_choice.traversal != "auto") text += " --traversal " + device_choice.traversal;
    return text;
}

void add_channels_option(CLI::App& command, std::optional<std::string>& parsed_channel_list) {
    add_option(
        command, "--channels LIST", parsed_channel_list,
        fmt::format(
            "additional channels of scans, separated by commas: {}; short for --set render.channels=LIST",
            fmt::join(optional_names(), ", ")));
}

void add_weather_option(CLI::App& command, std::string& text, const std::string& scope) {
    add_option(
        command, "--weather WEATHER", text,
        fmt::format("{}; applies to {} (default: clear); the channel `source` says what caused each point",
                    weather_help(), scope));
}

void add_set_option(CLI::App& command, std::vector<std::string>& parsed_setting_texts) {
    add_list_option(
        command, "--set KEY=VALUE", parsed_setting_texts,
        "change one setting, for example loss.depth=0.2; repeatable; `relidar list settings` lists all keys");
}

void add_no_refine_option(CLI::App& command, bool& no_refine) {
    command.add_flag("--no-refine", no_refine,
                     "do not use the ray-drop network of the run; the surfels alone decide which rays drop");
}

void add_settings_options(CLI::App& command, SettingsCommandOptions& settings) {
    add_option(command, "--preset NAME", settings.preset,
               "settings to start from: default, quick (trains in minutes on a CPU), paper (as described in "
               "the paper) or released (as in the authors' code)");
    add_option(command, "--config FILE", settings.file,
               "TOML file with settings that replace those of the preset");
    add_set_option(command, settings.sets);
}

Config make_config(const SettingsCommandOptions& settings) {
    Config config = make_preset(settings.preset);
    if (!settings.file.empty()) apply_file(config, settings.file);
    apply_settings(config, settings.sets);
    return config;
}

void apply_settings(Config& config, const std::vector<std::string>& key_value_texts) {
    for (const std::string& set : key_value_texts) {
        const std::size_t equals = set.find('=');
        if (equals == std::string::npos || equals == 0)
            fail<UsageError>("--set: found \"{}\"; expected KEY=VALUE, for example loss.depth=0.2", set);
        set_value(config, set.substr(0, equals), set.substr(equals + 1));
    }
}

std::vector<std::string> render_settings() {
    return split_text(
        "dataset.min_range_m,dataset.max_range_m,sensor.grid,sensor.grid_method,sensor.rolling_shutter,"
        "sensor.sub_rays,sensor.divergence_mrad,sensor.returns,sensor.return_separation_m,image.,refine."
        "enabled,render.,trace.",
        ',');
}

void check_settings_used(const std::vector<std::string>& setting_texts,
                         const std::vector<std::string>& names_and_prefixes_with_effect,
                         const std::string& command_name) {
    Config unused;
    for (const std::string& set : setting_texts) {
        // Called only for its error: the name is unknown or the value is invalid.
        apply_settings(unused, {set});
        const std::string key = set.substr(0, set.find('='));
        const bool is_used =
            std::ranges::any_of(names_and_prefixes_with_effect, [&](const std::string& name) {
                return name.ends_with('.') ? key.starts_with(name) : key == name;
            });
        if (is_used) continue;
        const std::string expected =
            names_and_prefixes_with_effect.empty()
                ? "no setting"
                : fmt::format("one of {}", fmt::join(names_and_prefixes_with_effect, ", "));
        fail<UsageError>("--set: the setting {} has no effect in `relidar {}`; expected {}", key,
                         command_name, expected);
    }
}

void add_log_options(CLI::App& command, LogSelection& log_selection) {
    add_option(command, "--frames A:B", log_selection.frames,
               "frames of the log to read, first:end, by the dataset's frame numbers (default: all)");
    add_option(command, "--sequence NAME", log_selection.sequence,
               "name of the drive if the dataset contains several (default: the first)");
}

void apply_selection(Config& config, const LogSelection& log_selection) {
    if (!log_selection.sequence.empty()) config.dataset.sequence = log_selection.sequence;
    if (log_selection.frames.empty()) return;
    const FrameRange range = parse_frames(log_selection.frames);
    config.dataset.frames_begin = range.begin;
    config.dataset.frames_end = range.end;
}

FrameRange parse_frames(const std::string& text) {
    const std::size_t colon = text.find(':');
    const bool has_colon = colon != std::string::npos;
    const std::string begin_text = text.substr(0, colon), end_text = has_colon ? text.substr(colon + 1) : "";
    // A missing begin is 0, a missing end is -1.
    const std::optional<int> begin = begin_text.empty() ? 0 : parse_number<int>(begin_text);
    const std::optional<int> end = end_text.empty() ? -1 : parse_number<int>(end_text);
    const bool is_valid = has_colon && begin && *begin >= 0 && end && (end_text.empty() || *end >= 0);
    if (!is_valid)
        fail<UsageError>(
            "--frames: found \"{}\"; expected FIRST:END, for example 0:50 for the frames 0 to 49", text);
    if (*end != -1 && *begin >= *end)
        fail<UsageError>("--frames: found the empty range \"{}\"; expected FIRST:END with FIRST < END", text);
    return {*begin, *end};
}

void note_missing_frames(const FrameRange& requested, int last, const std::string& source) {
    if (requested.end > last + 1)
        print_note(fmt::format("frames {}:{}: {} ends with frame {}; the missing frames are skipped",
                               requested.begin, requested.end, source, last));
}

std::optional<double> parse_finite(const std::string& text) {
    const std::optional<double> value = parse_number<double>(trim_spaces(text));
    return value && std::isfinite(*value) ? value : std::nullopt;
}

std::vector<double> parse_list(const std::string& option_name, const std::string& text) {
    std::vector<double> numbers;
    for (const std::string& typed : split_text(text, ',')) {
        const std::optional<double> value = parse_finite(typed);
        if (!value)
            fail<UsageError>("{}: found \"{}\" in \"{}\", expected finite numbers separated by commas",
                             option_name, trim_spaces(typed), text);
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

std::string trim_spaces(const std::string& text) {
    const std::size_t begin = text.find_first_not_of(" \t"), end = text.find_last_not_of(" \t");
    return begin == std::string::npos ? "" : text.substr(begin, end - begin + 1);
}

Run load_configured_run(const std::string& folder, const std::vector<std::string>& sets,
                        const std::optional<std::string>& channels, bool no_refine) {
    Run run = load_run(folder);
    apply_settings(run.config, sets);
    run.config = with_max_range(std::move(run.config), run.log);
    if (channels) set_value(run.config, "render.channels", *channels);
    if (no_refine) run.config.refine.enabled = false;
    return run;
}

std::string absolute_path(const std::string& path) {
    if (path.empty()) return path;
    const std::string clean = fs::absolute(path).lexically_normal().string();
    return clean.size() > 1 && clean.back() == '/' ? clean.substr(0, clean.size() - 1) : clean;
}

Log load_dataset(const Config& config, bool quiet, int max_scans_per_lidar) {
    TerminalProgress progress(quiet);
    limit_scan_memory(std::uint64_t(config.dataset.memory_mib) << 20);
    Log log = load_log(config, progress_callback(progress), max_scans_per_lidar);
    if (!log.frames.empty())
        note_missing_frames({config.dataset.frames_begin, config.dataset.frames_end}, log.frames.back().index,
                            log.source);
    const ScanMemoryUse use = scan_memory_use();
    if (use.in_file > 0 && !quiet)
        print_note(fmt::format(
            "{} of scan data are stored in memory and {} in a temporary file in {}; the setting "
            "dataset.memory_mib is the limit",
            format_bytes(use.in_memory), format_bytes(use.in_file), fs::temp_directory_path().string()));
    return log;
}

}  // namespace relidar::cli
