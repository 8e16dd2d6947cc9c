// SPDX-License-Identifier: Apache-2.0
// --topic and --frame-id: what recordings call sensors.
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
    std::string topic, frame_id;  ///< with {name} for the name of a sensor; empty: by the sensor's name
};
void add_recording_options(CLI::App& command, RecordingNames& names);
/// @param is_rig  whether several sensors want names @throws UsageError for names without
/// a recording, or one name for several sensors
void check_recording_names(const RecordingNames& names, const std::vector<std::string>& formats, bool is_rig);
/// @param sensor  its name in the rig or the log, or empty
void name_in_recordings(ScanFormat& format, const std::string& sensor, const RecordingNames& names);

}  // namespace relidar::cli
