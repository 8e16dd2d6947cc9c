// SPDX-License-Identifier: Apache-2.0
#include "recording_format.hpp"

namespace relidar::scan_files {

std::span<const RecordingFormat> recording_formats() {
    // rosbag2 takes numbers for policies of quality of service where a bag says nothing
    // of itself here, as those before version 9 did
    static const RecordingFormat formats[] = {
        {"mcap", "scans.mcap", "", "protobuf", "protobuf", {}, foxglove_topics},
        {"rosbag",
         "rosbag.mcap",
         "ros2",
         "ros2msg",
         "cdr",
         {{"rosbag2", {{"serialized_metadata", ""}}}},
         ros_topics},
    };
    return formats;
}

}  // namespace relidar::scan_files
