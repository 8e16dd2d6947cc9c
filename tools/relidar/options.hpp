// SPDX-License-Identifier: Apache-2.0
// Options that several commands share, and their conversion into settings, a device and a
// loaded log.
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
/// Returns the options as command line words. Default values are left out.
std::vector<std::string> device_words(const DeviceChoice& choice);

/// Values of --preset, --config and --set, in the order in which they take effect.
struct Settings {
    std::string preset = "default";
    std::string file;
    std::vector<std::string> sets;  ///< Each has the form "key=value".
};
void add_settings_options(CLI::App& command, Settings& settings);
/// Adds --channels, a short form of the setting render.channels.
void add_channels_option(CLI::App& command, std::optional<std::string>& channels);
/// Adds --weather.
/// @param weather receives the text for parse_weather()
/// @param which names the affected scans in the help text
void add_weather_option(CLI::App& command, std::string& weather, const std::string& which);
/// Adds only --set, for commands that take their settings from a run.
void add_set_option(CLI::App& command, std::vector<std::string>& sets);
Config resolve(const Settings& settings);
void apply_sets(Config& config, const std::vector<std::string>& sets);
/// Returns the settings that affect rendering: names of settings, or prefixes of groups
/// that end in a dot.
std::vector<std::string> rendering_settings();
/// Rejects settings that have no effect in a command.
/// @param used names and prefixes as returned by rendering_settings()
/// @param command name of the command
/// @throws UsageError that names the first such setting
void check_sets(const std::vector<std::string>& sets, const std::vector<std::string>& used,
                const std::string& command);

/// Values of --frames and --sequence: the part of a log that is read.
struct LogPart {
    std::string frames;
    std::string sequence;
};
void add_log_part_options(CLI::App& command, LogPart& part);
void apply_log_part(Config& config, const LogPart& part);

/// Parses "a:b", where either side may be empty.
/// @throws UsageError if the text has another form
FrameRange parse_frames(const std::string& text);
/// Prints a note if the requested frames extend beyond the end of a log or run.
/// @param last number of the last frame of the log or run
void note_frames_beyond(const FrameRange& range, int last, const std::string& where);
/// Parses numbers separated by commas.
/// @throws UsageError that names the option
std::vector<double> parse_list(const std::string& option, const std::string& text);
std::vector<std::string> split(const std::string& text, char separator);
std::string without_blanks(const std::string& text);  ///< Removes spaces and tabs at both ends.

std::string absolute_path(const std::string& path);  ///< Returns an empty path unchanged.
/// Loads the log that config.dataset describes.
/// @param most_scans see DatasetOptions::most_scans
Sequence load_dataset(const Config& config, bool quiet = false, int most_scans = 0);

}  // namespace relidar::cli
