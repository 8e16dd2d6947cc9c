// SPDX-License-Identifier: Apache-2.0
// All scans of a rendering in one file that players open: for Foxglove, or as a bag of ROS 2.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "mcap_writer.hpp"
#include "recorded_scan.hpp"

namespace relidar::scan_files {

inline constexpr const char* kRecordingKinds[] = {"mcap", "rosbag"};
/// Name of the file of a kind.
std::string recording_name(const std::string& kind);

/// A recording appears under its name when it is finished; until then it lies beside it under a temporary name.
class ScanRecording {
public:
    /// @param kind  of kRecordingKinds @param notes  what the file says of itself @throws DataError as all that write
    ScanRecording(std::filesystem::path path, const std::string& kind, const FileNotes& notes);
    /// Leaves nothing behind where finish() was not called.
    ~ScanRecording();
    ScanRecording(const ScanRecording&) = delete;
    ScanRecording& operator=(const ScanRecording&) = delete;

    /// @param time_s  of the log, from when times of points count
    void add(RecordedScan scan, double time_s);
    void finish();

private:
    struct Topic {
        std::uint16_t channel;
        std::function<std::string(const RecordedScan&)> message;
        bool of_sensor_frame = false;   ///< makes no sense of points in the world
    };
    std::filesystem::path path_, temporary_;
    bool ros_;
    FileNotes notes_;
    McapWriter writer_;
    std::vector<Topic> topics_;
    std::optional<double> shift_s_;   ///< of all times, known with the first scan

    void add_foxglove_topics();
    void add_ros_topics();
    void begin(double first_s);
};

}  // namespace relidar::scan_files
