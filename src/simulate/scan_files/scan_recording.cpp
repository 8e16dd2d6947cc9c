// SPDX-License-Identifier: Apache-2.0
#include "scan_recording.hpp"

#include <algorithm>
#include <map>
#include <system_error>
#include <utility>

#include <relidar/base/files.hpp>

namespace relidar::scan_files {

namespace fs = std::filesystem;

RecordingFileWriter::RecordingFileWriter(fs::path path, const RecordingFormat& format, const RecordedRig& rig,
                                         const FileMetadata& notes)
    : path_(std::move(path)),
      temporary_(make_unique_temporary_path(path_)),
      writer_(temporary_, format.profile),
      topics_(format.topics(rig)) {
    std::map<std::string, std::uint16_t> schemas;
    for (const RecordedTopic& topic : topics_) {
        if (!schemas.contains(topic.type))
            schemas[topic.type] =
                writer_.add_schema(topic.type, format.definition_encoding, topic.definition);
        channels_.push_back(
            writer_.add_channel(schemas[topic.type], topic.name, format.message_encoding, topic.metadata));
    }
    for (const auto& [name, values] : format.metadata) writer_.add_metadata(name, values);
    writer_.add_metadata("relidar", {notes.begin(), notes.end()});
}

RecordingFileWriter::~RecordingFileWriter() {
    std::error_code failed;
    fs::remove(temporary_, failed);
}

void RecordingFileWriter::write_sweep_messages(const RecordedSweep& moment) {
    for (const ScanMessage& message : make_messages_in_time_order(topics_, moment)) {
        // Log times in the file must not decrease, although sweeps can overlap. If a
        // message is earlier than the previous message, it gets the log time of the
        // previous message.
        last_logged_ns_ = std::max(last_logged_ns_, message.time_ns);
        writer_.add_message(channels_[message.topic], last_logged_ns_, message.bytes);
    }
    // Starts a new chunk after every scan, because players display all messages of a scan
    // together.
    writer_.write_pending_chunk();
}

void RecordingFileWriter::finish_writing() {
    writer_.write_summary_and_close();
    // Flushes the file to disk, and then renames it to its final name.
    write_file_atomically(path_, [&](const fs::path& file) { fs::rename(temporary_, file); });
}

}  // namespace relidar::scan_files
