// SPDX-License-Identifier: Apache-2.0
// Table of recording formats.
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
    std::string type;        ///< message type
    std::string definition;  ///< definition of the type and of all types that it contains
    std::map<std::string, std::string> metadata;
    std::function<std::vector<RecordedMessage>(const RecordedMoment&)> messages;
};

struct RecordingFormat {
    const char* name;  ///< name in ScanFormat::formats
    const char* file;
    const char* profile;  ///< MCAP profile of the file
    const char *definition_encoding, *message_encoding;
    /// metadata records, in addition to those of the rendering
    std::map<std::string, std::map<std::string, std::string>> metadata;
    /// Returns the topics. Messages with the same time are written in the order of the
    /// topics.
    std::vector<RecordedTopic> (*topics)(const RecordedRig&);
};

std::span<const RecordingFormat> recording_formats();

/// Return the topics with Foxglove's schemas in protobuf, and with ROS 2 messages in CDR.
std::vector<RecordedTopic> foxglove_topics(const RecordedRig& rig);
std::vector<RecordedTopic> ros_topics(const RecordedRig& rig);

}  // namespace relidar::scan_files
