// SPDX-License-Identifier: Apache-2.0
// Lists the file formats of recordings and the topics that each format contains.
#pragma once

#include <relidar/simulate/scan_files.hpp>
#include "recorded_moment.hpp"

namespace relidar::scan_files {

struct RecordedMessage {
    std::uint64_t logged_ns;
    std::string bytes;
};
struct RecordedTopic {
    std::string name;
    std::string type;        ///< message type
    std::string definition;  ///< definition of the message type and of all message types that it contains
    std::map<std::string, std::string> metadata;
    std::function<std::vector<RecordedMessage>(const RecordedSweep&)> messages;
};

struct RecordingFormat {
    const char* name;  ///< name of the format in ScanOutputOptions::formats
    const char *file, *help;
    const char* profile;  ///< MCAP profile of the file
    const char *definition_encoding, *message_encoding;
    std::map<std::string, std::map<std::string, std::string>> metadata;
    /// Messages with the same time are written in the order of these topics.
    std::vector<RecordedTopic> (*topics)(const RecordedRig&);
};

std::span<const RecordingFormat> recording_formats();

/// Messages with the same time are in the order of the topics.
std::vector<ScanMessage> sorted_messages(std::span<const RecordedTopic> topics, const RecordedSweep& moment);

std::vector<RecordedTopic> foxglove_topics(const RecordedRig& rig);
std::vector<RecordedTopic> ros_topics(const RecordedRig& rig);

}  // namespace relidar::scan_files
