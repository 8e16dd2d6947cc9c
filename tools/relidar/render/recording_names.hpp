// SPDX-License-Identifier: Apache-2.0
// Reads the options --topic and --frame-id, which set the names of the sensors in
// recordings.
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
    /// Topic and frame id in recordings. The text {name} is replaced by the name of the
    /// sensor. If an option is empty, its value is derived from the name of the sensor.
    std::string topic, frame_id;
};
void add_recording_options(CLI::App& command, RecordingNames& names);
/// Checks the options --topic and --frame-id.
/// @param is_rig true if there are several sensors
/// @throws UsageError if no recording is written, or if several sensors would have the
/// same name
void check_recording_names(const RecordingNames& names, const std::vector<std::string>& formats, bool is_rig);
/// Sets the topic and the frame id of a sensor in the output format.
/// @param sensor name of the sensor in the rig or in the log; may be empty
void name_in_recordings(ScanFormat& format, const std::string& sensor, const RecordingNames& names);

}  // namespace relidar::cli
