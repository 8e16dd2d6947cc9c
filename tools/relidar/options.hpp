// SPDX-License-Identifier: Apache-2.0
// Options that several commands share, and how they become settings, a device and a
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

/// --device and --traversal.
struct DeviceChoice {
    int index = -1;
    std::string traversal = "auto";
};
void add_device_options(CLI::App& command, DeviceChoice& choice);
DeviceOptions device_options(const DeviceChoice& choice);
/// As typed on a command line: nothing where the default was chosen.
std::vector<std::string> device_words(const DeviceChoice& choice);

/// --preset, --config and --set, in the order in which they take effect.
struct Settings {
    std::string preset = "default";
    std::string file;
    std::vector<std::string> sets;  ///< "key=value"
};
void add_settings_options(CLI::App& command, Settings& settings);
/// --channels, which is the setting render.channels.
void add_channels_option(CLI::App& command, std::optional<std::string>& channels);
/// --weather. @param weather  text for parse_weather() @param which  scans, for the help
void add_weather_option(CLI::App& command, std::string& weather, const std::string& which);
/// --set alone: for commands whose settings come with a run.
void add_set_option(CLI::App& command, std::vector<std::string>& sets);
Config resolve(const Settings& settings);
void apply_sets(Config& config, const std::vector<std::string>& sets);
/// Settings that rendering a run reads: those of these names, or of groups that end in a
/// dot.
std::vector<std::string> rendering_settings();
/// Refuses settings that a command would read without an effect. @param used  as
/// rendering_settings() @param command  its name
/// @throws UsageError naming the first of them
void check_sets(const std::vector<std::string>& sets, const std::vector<std::string>& used,
                const std::string& command);

/// --frames and --sequence: what of a log is read.
struct LogPart {
    std::string frames;
    std::string sequence;
};
void add_log_part_options(CLI::App& command, LogPart& part);
void apply_log_part(Config& config, const LogPart& part);

/// "a:b", either side may be empty. @throws UsageError
FrameRange parse_frames(const std::string& text);
/// Tells that a log or a run ends before the frames that are wanted do. @param last frame
/// of it
void note_frames_beyond(const FrameRange& range, int last, const std::string& where);
/// Numbers parted by commas. @throws UsageError naming the option
std::vector<double> parse_list(const std::string& option, const std::string& text);
std::vector<std::string> split(const std::string& text, char separator);
std::string without_blanks(const std::string& text);  ///< at both ends

std::string absolute_path(const std::string& path);  ///< empty stays empty
/// The log that config.dataset describes.
/// @param most_scans  DatasetOptions::most_scans
Sequence load_dataset(const Config& config, bool quiet = false, int most_scans = 0);

}  // namespace relidar::cli
