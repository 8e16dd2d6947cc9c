// SPDX-License-Identifier: Apache-2.0
// Command line options that several commands share. The functions convert option values
// to settings, select a device, or load a log.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <CLI/CLI.hpp>

#include <relidar/gpu/device.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/config.hpp>

namespace relidar::cli {

/// @param name with the word for the value in the help, for example "--out DIR"
template <class T>
CLI::Option* add_option(CLI::App& command, const std::string& name, T& value, const std::string& help) {
    const std::size_t space = name.find(' ');
    return command.add_option(name.substr(0, space), value, help)->type_name(name.substr(space + 1));
}
/// A list whose option is repeated for each value.
inline void add_list_option(CLI::App& command, const std::string& name, std::vector<std::string>& values,
                            const std::string& help) {
    add_option(command, name, values, help)->type_size(1)->allow_extra_args(false);
}

struct DeviceCommandOptions {
    int index = -1;
    std::string traversal = "auto";
};
void add_device_options(CLI::App& command, DeviceCommandOptions& device_choice);
void add_quiet_option(CLI::App& command, bool& quiet);
DeviceOptions to_device_options(const DeviceCommandOptions& device_choice);
/// For example "relidar train --resume RUN --device 1", with the options that differ from
/// their defaults.
std::string resume_command(const std::string& command, const std::string& run,
                           const DeviceCommandOptions& device_choice);

/// A later option in this order overwrites an earlier one.
struct SettingsCommandOptions {
    std::string preset = "default";
    std::string file;
    std::vector<std::string> sets;  ///< Settings of the form "key=value".
};
void add_settings_options(CLI::App& command, SettingsCommandOptions& settings);
void add_channels_option(CLI::App& command, std::optional<std::string>& parsed_channel_list);
/// @param text output; parse_weather() reads it later
/// @param scope says to which scans the weather applies
void add_weather_option(CLI::App& command, std::string& text, const std::string& scope);
void add_set_option(CLI::App& command, std::vector<std::string>& parsed_setting_texts);
void add_no_refine_option(CLI::App& command, bool& no_refine);
Config make_config(const SettingsCommandOptions& settings);
void apply_settings(Config& config, const std::vector<std::string>& key_value_texts);
/// A name that ends in a dot means all settings of that group.
std::vector<std::string> render_settings();
/// @param names_and_prefixes_with_effect a name that ends in a dot means all settings of
/// that group
/// @throws UsageError that names the first setting without effect
void check_settings_used(const std::vector<std::string>& setting_texts,
                         const std::vector<std::string>& names_and_prefixes_with_effect,
                         const std::string& command_name);

struct LogSelection {
    std::string frames;
    std::string sequence;
};
void add_log_options(CLI::App& command, LogSelection& log_selection);
void apply_selection(Config& config, const LogSelection& log_selection);

/// "a:b"; either number may be missing.
/// @throws UsageError if the text has another form
FrameRange parse_frames(const std::string& text);
void note_missing_frames(const FrameRange& requested, int last, const std::string& source);
std::optional<double> parse_finite(const std::string& text);
/// Separated by commas.
/// @throws UsageError that names the option if a word is not a number
std::vector<double> parse_list(const std::string& option_name, const std::string& text);
std::vector<std::string> split_text(const std::string& text, char separator);
std::string trim_spaces(const std::string& text);  ///< Removes spaces and tabs at both ends of a text.

std::string absolute_path(const std::string& path);
/// @param max_scans_per_lidar 0: all scans
Log load_dataset(const Config& config, bool quiet = false, int max_scans_per_lidar = 0);

}  // namespace relidar::cli
