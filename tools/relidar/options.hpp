// SPDX-License-Identifier: Apache-2.0
// Options that several commands share. Functions convert the options to settings, open a
// device or load a log.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <relidar/gpu/device.hpp>
#include <relidar/log/dataset.hpp>
#include <relidar/run/config.hpp>

namespace CLI {
class App;
}

namespace relidar::cli {

/// Values of --device and --traversal.
struct DeviceChoice {
    int index = -1;
    std::string traversal = "auto";
};
void add_device_options(CLI::App& command, DeviceChoice& choice);
DeviceOptions device_options(const DeviceChoice& choice);
/// Converts the options of a device back to words of a command line. Leaves out options
/// with default values.
std::vector<std::string> device_arguments(const DeviceChoice& choice);

/// Values of --preset, --config and --set. They are applied in this order.
struct Settings {
    std::string preset = "default";
    std::string file;
    std::vector<std::string> sets;  ///< Settings of the form "key=value".
};
void add_settings_options(CLI::App& command, Settings& settings);
/// Adds the option --channels, which is a short form of the setting render.channels.
void add_channels_option(CLI::App& command, std::optional<std::string>& channels);
/// Adds the option --weather.
/// @param weather receives the text, which parse_weather() reads later
/// @param which words for the help text that name the affected scans
void add_weather_option(CLI::App& command, std::string& weather, const std::string& which);
/// Adds the option --set, but not --preset and --config. Used by commands that read their
/// settings from a run.
void add_set_option(CLI::App& command, std::vector<std::string>& sets);
Config resolve(const Settings& settings);
void apply_sets(Config& config, const std::vector<std::string>& sets);
/// Returns the names of the settings that affect rendering. A name that ends in a dot
/// stands for all settings of a group.
std::vector<std::string> rendering_settings();
/// Rejects settings that would have no effect in a command.
/// @param used names and groups of settings that the command uses, as in
/// rendering_settings()
/// @param command name of the command
/// @throws UsageError that names the first setting without effect
void check_sets(const std::vector<std::string>& sets, const std::vector<std::string>& used,
                const std::string& command);

/// Values of --frames and --sequence. They select the part of a log that is read.
struct LogPart {
    std::string frames;
    std::string sequence;
};
void add_log_part_options(CLI::App& command, LogPart& part);
void apply_log_part(Config& config, const LogPart& part);

/// Parses a range "a:b". Each of the two numbers may be missing.
/// @throws UsageError if the text has another form
FrameRange parse_frames(const std::string& text);
/// Prints a note if the log or run has fewer frames than requested.
/// @param last number of the last frame of the log or run
void note_frames_beyond(const FrameRange& range, int last, const std::string& where);
/// Parses a list of numbers that are separated by commas.
/// @throws UsageError that names the option
std::vector<double> parse_list(const std::string& option, const std::string& text);
std::vector<std::string> split(const std::string& text, char separator);
std::string without_blanks(const std::string& text);  ///< Removes spaces and tabs at both ends of a text.

/// Returns the absolute path. An empty path stays empty.
std::string absolute_path(const std::string& path);
/// Loads the log that the settings in config.dataset describe.
/// @param max_scans see DatasetOptions::max_scans
Sequence load_dataset(const Config& config, bool quiet = false, int max_scans = 0);

}  // namespace relidar::cli
