// SPDX-License-Identifier: Apache-2.0
#include "render/recording_names.hpp"

#include <algorithm>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/base/error.hpp>
#include <relidar/simulate/scan_files.hpp>

namespace relidar::cli {
namespace {

constexpr std::string_view kName = "{name}";

std::string replace_name_placeholder(std::string text, const std::string& sensor_name) {
    for (std::size_t at = 0; (at = text.find(kName, at)) != std::string::npos; at += sensor_name.size())
        text.replace(at, kName.size(), sensor_name);
    return text;
}

}  // namespace

void add_recording_options(CLI::App& command, RecordingNames& names) {
    command
        .add_option(
            "--topic", names.topic,
            "topic of the point clouds in mcap and rosbag; {name} stands for the sensor's name in a rig or "
            "the log (default: /lidar/points, or /lidar/{name}/points if the sensor has a name)")
        ->type_name("NAME");
    command
        .add_option(
            "--frame-id", names.frame_id,
            "frame id of the sensor in mcap and rosbag; may also contain {name} (default: lidar, or {name})")
        ->type_name("NAME");
}

void check_recording_names(const RecordingNames& names, const std::vector<std::string>& formats,
                           bool is_rig) {
    const auto check = [&](const char* option, const std::string& text) {
        if (text.empty()) return;
        if (std::ranges::none_of(formats, is_recording_format))
            throw UsageError(fmt::format(
                "{} has no effect on the selected formats; expected mcap or rosbag in --format, because "
                "other files have no topics and frame ids",
                option));
        if (is_rig && text.find(kName) == std::string::npos)
            throw UsageError(fmt::format(
                "{}: found \"{}\" for all sensors of a rig; expected a text that contains {}, which is "
                "replaced by the name of each sensor",
                option, text, kName));
    };
    check("--topic", names.topic), check("--frame-id", names.frame_id);
}

void set_topic_and_frame_id(ScanOutputOptions& format, const std::string& sensor_name,
                            const RecordingNames& names) {
    relidar::set_recording_topic(format, sensor_name);
    const std::string name = sensor_name.empty() ? format.frame_id : sensor_name;
    if (!names.topic.empty())
        format.topic = replace_name_placeholder(names.topic, make_valid_topic_name(name));
    if (!names.frame_id.empty()) format.frame_id = replace_name_placeholder(names.frame_id, name);
}

}  // namespace relidar::cli
