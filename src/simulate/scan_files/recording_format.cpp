// SPDX-License-Identifier: Apache-2.0
#include "recording_format.hpp"

namespace relidar::scan_files {

std::span<const RecordingFormat> recording_formats() {
    // rosbag2 reads the quality-of-service policies as numbers because of the empty
    // metadata entry `serialized_metadata`.
    static const RecordingFormat formats[] = {
        {"mcap",
         "scans.mcap",
         "one file with all scans of all sensors, for Foxglove.",
         "",
         "protobuf",
         "protobuf",
         {},
         foxglove_topics},
        {"rosbag",
         "rosbag.mcap",
         R"(a ROS 2 bag. Both contain the transforms of world, base_link (the log's vehicle)
and sensors, and the boxes of actors. --deskew moves points to the time of the first ray.)",
         "ros2",
         "ros2msg",
         "cdr",
         {{"rosbag2", {{"serialized_metadata", ""}}}},
         ros_topics},
    };
    return formats;
}

std::vector<ScanMessage> sorted_messages(std::span<const RecordedTopic> topics, const RecordedSweep& moment) {
    std::vector<ScanMessage> messages;
    for (std::size_t topic = 0; topic < topics.size(); ++topic)
        for (auto& [time_ns, bytes] : topics[topic].messages(moment))
            messages.push_back({topic, time_ns, std::move(bytes)});
    std::ranges::stable_sort(messages, {}, &ScanMessage::time_ns);
    return messages;
}

}  // namespace relidar::scan_files
