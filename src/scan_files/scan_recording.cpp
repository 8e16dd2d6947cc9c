// SPDX-License-Identifier: Apache-2.0
#include "scan_recording.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <system_error>

#include <unistd.h>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include "foxglove_messages.hpp"
#include "ros_messages.hpp"

namespace relidar::scan_files {
namespace {

namespace fs = std::filesystem;

constexpr double kLatest_s = 2147483647.0;   // seconds of a stamp of ROS have 31 bits

/// As write_atomically() names its own, so that remove_temporaries() finds what a killed process leaves.
fs::path temporary_name(const fs::path& path) {
    static std::atomic<unsigned> count{0};
    return path.parent_path() / fmt::format(".{}.tmp-{}-{}", path.filename().string(), ::getpid(), count++);
}

}  // namespace

std::string recording_name(const std::string& kind) { return kind == "rosbag" ? "rosbag.mcap" : "scans.mcap"; }

ScanRecording::ScanRecording(fs::path path, const std::string& kind, const FileNotes& notes)
    : path_(std::move(path)), temporary_(temporary_name(path_)), ros_(kind == "rosbag"), notes_(notes),
      writer_(temporary_, ros_ ? "ros2" : "") {
    ros_ ? add_ros_topics() : add_foxglove_topics();
}

ScanRecording::~ScanRecording() {
    std::error_code failed;
    fs::remove(temporary_, failed);
}

void ScanRecording::add_foxglove_topics() {
    const std::string descriptors = foxglove_descriptors();
    const auto add = [&](const char* topic, const char* schema, std::string (*message)(const RecordedScan&)) {
        topics_.push_back({writer_.add_channel(writer_.add_schema(schema, "protobuf", descriptors), topic, "protobuf"), message});
    };
    add("/tf", "foxglove.FrameTransform", foxglove_transform);
    add("/lidar/points", "foxglove.PointCloud", foxglove_points);
    add("/actors", "foxglove.SceneUpdate", foxglove_boxes);
}

void ScanRecording::add_ros_topics() {
    const std::uint16_t transforms = writer_.add_schema("tf2_msgs/msg/TFMessage", "ros2msg", ros_transform_definition()),
                        clouds = writer_.add_schema("sensor_msgs/msg/PointCloud2", "ros2msg", ros_points_definition());
    topics_.push_back({writer_.add_channel(transforms, "/tf", "cdr"), ros_transform});
    topics_.push_back({writer_.add_channel(clouds, "/lidar/points", "cdr"), [](const auto& s) { return ros_points(s, RosPoints::plain); }});
    topics_.push_back({writer_.add_channel(clouds, "/lidar/points_xyzircaedt", "cdr"),
                       [](const auto& s) { return ros_points(s, RosPoints::autoware); }, true});
}

/// Times of files begin at 0: a log that begins before that is moved by whole seconds.
void ScanRecording::begin(double first_s) {
    shift_s_ = first_s < 0.0 ? std::ceil(-first_s) : 0.0;
    std::map<std::string, std::string> values(notes_.begin(), notes_.end());
    values["time_shift_s"] = fmt::format("{}", *shift_s_);    // added to times of the log
    writer_.add_metadata("relidar", values);
}

void ScanRecording::add(RecordedScan scan, double time_s) {
    const double first_s = time_s + std::min(scan.first_time_s, 0.0);
    if (!shift_s_) begin(first_s);
    if (!(first_s + *shift_s_ >= 0.0 && time_s + *shift_s_ < kLatest_s))
        throw DataError(fmt::format("writing '{}': found a scan at {} s, expected times that do not fall, and lie before 2038",
                                    path_.string(), time_s));
    scan.time_ns = std::uint64_t(std::llround(1e9 * (time_s + *shift_s_)));
    const std::uint64_t logged_ns = ros_ ? ros_stamp_ns(scan) : scan.time_ns;
    for (const Topic& topic : topics_)
        if (!topic.of_sensor_frame || !scan.world) writer_.add_message(topic.channel, logged_ns, topic.message(scan));
    writer_.end_chunk();   // one a scan: what a player shows at a time
}

void ScanRecording::finish() {
    writer_.close();
    write_atomically(path_, [&](const fs::path& file) { fs::rename(temporary_, file); });   // flushes it, and gives it its name
}

}  // namespace relidar::scan_files
