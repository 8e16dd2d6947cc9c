// SPDX-License-Identifier: Apache-2.0
#include "render/recording_names.hpp"

#include <algorithm>

#include <fmt/ranges.h>
#include <CLI/CLI.hpp>

#include <relidar/simulate/scan_files.hpp>

#include "base/fail.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

constexpr std::string_view kNamePlaceholder = "{name}";

/// Replaces each "{name}" in a text of the user.
std::string replace_name(std::string text, const std::string& sensor_name) {
    for (std::size_t at = 0; (at = text.find(kNamePlaceholder, at)) != std::string::npos;
         at += sensor_name.size())
        text.replace(at, kNamePlaceholder.size(), sensor_name);
    return text;
}

}  // namespace

std::vector<std::string> parse_formats(const std::string& format_list) {
    const std::vector<std::string> known_formats = scan_formats();
    std::vector<std::string> formats;
    for (const std::string& word : split_text(format_list, ',')) {
        const std::string name = trim_spaces(word);
        const std::optional<std::string> format = find_name(name, known_formats);
        if (!format)
            fail<UsageError>("--format: \"{}\" is unknown{} (known formats: {})", name,
                             did_you_mean(name, known_formats), fmt::join(known_formats, ", "));
        formats.push_back(*format);
    }
    return formats;
}

PointCoordinateFrame parse_frame(const std::string& name) {
    if (find_name(name, {"sensor"})) return PointCoordinateFrame::sensor;
    if (find_name(name, {"world"})) return PointCoordinateFrame::world;
    fail<UsageError>("--frame: found \"{}\"; expected sensor or world (use --frames to select scans)", name);
}

void check_map_formats(const std::string& crs, const std::vector<std::string>& formats) {
    for (const std::string& format : formats)
        if (!crs.empty() && format != "las" && format != "ply" && format != "pcd")
            fail<UsageError>("--crs {}: found --format {}; expected las, ply or pcd", crs, format);
}

void add_name_options(CLI::App& command, RecordingNames& parsed_names) {
    add_option(command, "--topic NAME", parsed_names.topic,
               "topic of the point clouds in mcap and rosbag; {name} stands for the sensor's name in a rig "
               "or the log (default: /lidar/points, or /lidar/{name}/points if the sensor has a name)");
    add_option(command, "--frame-id NAME", parsed_names.frame_id,
               "frame id of the sensor in mcap and rosbag; {name} stands for the sensor's name as in --topic "
               "(default: lidar, or {name} if the sensor has a name)");
}

void check_recording_names(const RecordingNames& name_templates,
                           const std::vector<std::string>& output_file_formats, bool has_several_sensors) {
    const auto check_name = [&](const char* option, const std::string& text) {
        if (text.empty()) return;  // The option is not used.
        if (std::ranges::none_of(output_file_formats, is_recording))
            fail<UsageError>("{} has no effect on these formats; expected --format mcap or rosbag", option);
        if (has_several_sensors && text.find(kNamePlaceholder) == std::string::npos)
            fail<UsageError>("{}: found \"{}\" for all sensors of a rig; expected a text with {}", option,
                             text, kNamePlaceholder);
    };
    check_name("--topic", name_templates.topic);
    check_name("--frame-id", name_templates.frame_id);
}

void apply_names(ScanOutputOptions& format, const std::string& sensor, const RecordingNames& names) {
    relidar::name_topics(format, sensor);
    const std::string name = sensor.empty() ? format.frame_id : sensor;
    if (!names.topic.empty()) format.topic = replace_name(names.topic, to_topic_name(name));
    if (!names.frame_id.empty()) format.frame_id = replace_name(names.frame_id, name);
}

}  // namespace relidar::cli
