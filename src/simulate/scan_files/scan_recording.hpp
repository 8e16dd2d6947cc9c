// SPDX-License-Identifier: Apache-2.0
// Writes all scans of a rendering to one MCAP file.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "base/codecs/mcap_writer.hpp"
#include "recording_format.hpp"

namespace relidar::scan_files {

/// Writes one recording. Until finish_writing() is called, the file has a temporary name
/// in the same folder.
class RecordingFileWriter {
public:
    /// Creates the file and writes the descriptions of its topics.
    /// @param notes metadata of the file
    /// @throws DataError if the file cannot be written
    RecordingFileWriter(std::filesystem::path path, const RecordingFormat& format, const RecordedRig& rig,
                        const FileMetadata& notes);
    /// Removes the temporary file if finish_writing() was not called.
    ~RecordingFileWriter();
    RecordingFileWriter(const RecordingFileWriter&) = delete;
    RecordingFileWriter& operator=(const RecordingFileWriter&) = delete;

    /// Writes the messages of all scans with the same time.
    void write_sweep_messages(const RecordedSweep& moment);
    void finish_writing();

private:
    std::filesystem::path path_, temporary_;
    McapWriter writer_;
    std::vector<RecordedTopic> topics_;
    std::vector<std::uint16_t> channels_;  ///< [topics] numbers of the topics in the file
    std::uint64_t last_logged_ns_ = 0;
};

}  // namespace relidar::scan_files
