// SPDX-License-Identifier: Apache-2.0
// Command line options that several commands share. The functions convert option values
// to settings, select a device, or load a log.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include <relidar/gpu/device.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/run/config.hpp>

#include "command.hpp"

namespace relidar {
struct Run;
}

namespace relidar::cli {

/// @param name with the word for the value in the help, for example "--out DIR"
template <class T>
CLI::Option* add_option(CLI::App& command, const std::string& name, T& value, const std::string& help) {
    const std::size_t space = name.find(' ');
    return command.add_option(name.substr(0, space), value, help)->type_name(name.substr(space + 1));
}
/// If the user has chosen `command`, the program calls `run` when it has parsed all
/// options. They are shared, because add_X() returns before the parser fills them.
template <class Options>
void run_after_parsing(CLI::App& command, ParsedCommand& call, const std::shared_ptr<Options>& options,
                       void (*run)(const Options&)) {
    command.callback([&call, options, run] { call.run = [options, run] { run(*options); }; });
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
/// Checks the options, and applies environment variables of users and developers.
DeviceOptions to_device_options(const DeviceCommandOptions& device_choice);
/// For example "relidar train --resume RUN --device 1", with the options that differ from
/// their defaults.
std::string resume_command(const std::string& command, const std::string& run,
                           const DeviceCommandOptions& device_choice);

/// A later option in this order overwrites an earlier option.
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
/// Rejects settings of --set that a command ignores, because the user expects an effect.
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

/// Parses a range of frame numbers "begin:end". Either number may be missing.
/// @throws UsageError if the text has another form
FrameRange parse_frames(const std::string& text);
void note_missing_frames(const FrameRange& requested, int last, const std::string& source);
std::optional<double> parse_finite(const std::string& text);
/// Parses finite numbers that are separated by commas.
/// @throws UsageError that names the option if a word is not a number
std::vector<double> parse_list(const std::string& option_name, const std::string& text);
std::vector<std::string> split_text(const std::string& text, char separator);
std::string trim_spaces(const std::string& text);  ///< Removes spaces and tabs at both ends of a text.

/// Loads a run and replaces its settings by those of the command line.
/// @param sets see SettingsCommandOptions::sets
/// @param channels value of --channels
/// @param no_refine true: does not use the ray-drop network of the run
Run load_configured_run(const std::string& folder, const std::vector<std::string>& sets,
                        const std::optional<std::string>& channels, bool no_refine);
std::string absolute_path(const std::string& path);
/// Reads the log of the settings, and prints notes about missing frames and large memory.
/// @param max_scans_per_lidar 0: all scans
Log load_dataset(const Config& config, bool quiet = false, int max_scans_per_lidar = 0);

}  // namespace relidar::cli
