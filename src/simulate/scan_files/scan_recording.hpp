// SPDX-License-Identifier: Apache-2.0
// One file with all moments of a rendering.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "base/codecs/mcap_writer.hpp"
#include "recording_format.hpp"

namespace relidar::scan_files {

/// A recording appears under its name when it is finished; until then it lies beside it
/// under a temporary name.
class ScanRecording {
public:
    /// @param notes  what the file says of itself @throws DataError as all that write
    ScanRecording(std::filesystem::path path, const RecordingFormat& format, const RecordedRig& rig,
                  const FileNotes& notes);
    /// Leaves nothing behind where finish() was not called.
    ~ScanRecording();
    ScanRecording(const ScanRecording&) = delete;
    ScanRecording& operator=(const ScanRecording&) = delete;

    /// @param shift_s  by how much the times of the file are later than the log's, the
    /// same for all moments
    void add(const RecordedMoment& moment, double shift_s);
    void finish();

private:
    struct Channel {
        std::uint16_t id;
        RecordedTopic topic;
    };
    std::filesystem::path path_, temporary_;
    FileNotes notes_;
    McapWriter writer_;
    std::vector<Channel> channels_;
    bool has_notes_ = false;
    std::uint64_t last_logged_ns_ = 0;
};

}  // namespace relidar::scan_files
