// SPDX-License-Identifier: Apache-2.0
#include "recording_format.hpp"

namespace relidar::scan_files {

std::span<const RecordingFormat> list_recording_formats() {
    // The empty key `serialized_metadata` makes rosbag2 read quality-of-service policies
    // as numbers, as in bags before version 9.
    static const RecordingFormat formats[] = {
        {"mcap", "scans.mcap", "", "protobuf", "protobuf", {}, list_foxglove_topics},
        {"rosbag",
         "rosbag.mcap",
         "ros2",
         "ros2msg",
         "cdr",
         {{"rosbag2", {{"serialized_metadata", ""}}}},
         list_ros_topics},
    };
    return formats;
}

}  // namespace relidar::scan_files
