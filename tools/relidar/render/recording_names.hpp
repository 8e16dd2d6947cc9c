// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

namespace CLI {
class App;
}
namespace relidar {
struct ScanOutputOptions;
enum class PointCoordinateFrame;
}  // namespace relidar

namespace relidar::cli {

struct RecordingNames {
    /// {name} is replaced by the name of the sensor. Empty: derived from this name.
    std::string topic, frame_id;
};
/// Parses the names of formats, separated by commas. Upper case and spaces are allowed.
std::vector<std::string> parse_formats(const std::string& format_list);
PointCoordinateFrame parse_frame(const std::string& name);  ///< value of --frame

/// Checks that all formats can be written on the map of --crs.
void check_map_formats(const std::string& crs, const std::vector<std::string>& formats);

void add_name_options(CLI::App& command, RecordingNames& parsed_names);
/// Checks the options --topic and --frame-id.
/// @throws UsageError if no recording (a file with all scans) is written, or if several
/// sensors would get the same name
void check_recording_names(const RecordingNames& name_templates,
                           const std::vector<std::string>& output_file_formats, bool has_several_sensors);
void apply_names(ScanOutputOptions& options, const std::string& name, const RecordingNames& names);

}  // namespace relidar::cli
