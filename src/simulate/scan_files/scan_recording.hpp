// SPDX-License-Identifier: Apache-2.0
// Writes all scans of a rendering to one MCAP file.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "base/codecs/mcap_writer.hpp"
#include "recording_format.hpp"

namespace relidar::scan_files {

/// Writes one recording. Until finish() is called, the file has a temporary name in the
/// same folder.
class ScanRecording {
public:
    /// Creates the file and writes the descriptions of its topics.
    /// @param notes metadata of the file
    /// @throws DataError if the file cannot be written
    ScanRecording(std::filesystem::path path, const RecordingFormat& format, const RecordedRig& rig,
                  const FileNotes& notes);
    /// Removes the temporary file if finish() was not called.
    ~ScanRecording();
    ScanRecording(const ScanRecording&) = delete;
    ScanRecording& operator=(const ScanRecording&) = delete;

    /// Writes the messages of all scans of the same time.
    /// @param shift_s offset that converts times of the log to times of the file; all
    /// calls must use the same offset
    void add(const RecordedMoment& moment, double shift_s);
    void finish();

private:
    std::filesystem::path path_, temporary_;
    FileNotes notes_;
    McapWriter writer_;
    std::vector<RecordedTopic> topics_;
    std::vector<std::uint16_t> channels_;  ///< [topics] numbers of the topics in the file
    bool has_notes_ = false;
    std::uint64_t last_logged_ns_ = 0;
};

}  // namespace relidar::scan_files
