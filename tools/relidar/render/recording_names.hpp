// SPDX-License-Identifier: Apache-2.0
// Handles --topic and --frame-id, which name the sensors in recordings.
#pragma once

#include <string>
#include <vector>

namespace CLI {
class App;
}
namespace relidar {
struct ScanFormat;
}

namespace relidar::cli {

struct RecordingNames {
    /// May contain {name}, which stands for the name of the sensor. Empty: derived from
    /// the sensor's name.
    std::string topic, frame_id;
};
void add_recording_options(CLI::App& command, RecordingNames& names);
/// Checks the names.
/// @param is_rig true if several sensors need names
/// @throws UsageError if names are given without a recording format, or one name is given
/// for several sensors
void check_recording_names(const RecordingNames& names, const std::vector<std::string>& formats, bool is_rig);
/// Sets the topic and frame id of a sensor.
/// @param sensor name of the sensor in the rig or the log, or empty
void name_in_recordings(ScanFormat& format, const std::string& sensor, const RecordingNames& names);

}  // namespace relidar::cli
