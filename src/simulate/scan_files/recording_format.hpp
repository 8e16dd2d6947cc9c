// SPDX-License-Identifier: Apache-2.0
// Kinds of recordings: a row each.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "recorded_moment.hpp"

namespace relidar::scan_files {

struct RecordedMessage {
    std::uint64_t logged_ns;
    std::string bytes;
};
struct RecordedTopic {
    std::string name;
    std::string type;        ///< of its messages
    std::string definition;  ///< of the type, with all that it is made of
    std::map<std::string, std::string> metadata;
    std::function<std::vector<RecordedMessage>(const RecordedMoment&)> messages;
};

struct RecordingFormat {
    const char* name;  ///< in ScanFormat::formats
    const char* file;
    const char* profile;  ///< of the container
    const char *definition_encoding, *message_encoding;
    /// records, beside what is said of the rendering
    std::map<std::string, std::map<std::string, std::string>> metadata;
    /// messages of one time are logged in the order of the topics
    std::vector<RecordedTopic> (*topics)(const RecordedRig&);
};

std::span<const RecordingFormat> recording_formats();

/// Topics of Foxglove's schemas in protobuf, and of ROS 2 in CDR.
std::vector<RecordedTopic> foxglove_topics(const RecordedRig& rig);
std::vector<RecordedTopic> ros_topics(const RecordedRig& rig);

}  // namespace relidar::scan_files
