// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>

namespace relidar::cli {

/// Notes if scans of a sensor lack motion or the ray-drop network of the run.
void note_sensor(const Run& run, const ScanRenderer& renderer, const SimulatedSensor& sensor);

/// Warns if `--sample` cannot add noise, because the run has no model of the noise.
void note_missing_noise(const Run& run, int lidar);

void note_time_shift(const Log& log, std::int64_t time_shift_ns);

void note_weather(const Weather& weather);

/// Returns the map of --crs, or nothing for an empty text. Notes if its lengths differ.
/// @throws UsageError if the log has no georeference
std::optional<MapProjector> open_map(const Log& log, const std::string& crs);

/// Notes if LAS files of points in the dataset's world name no coordinate system,
/// although the log has a georeference.
void note_local_las(const Log& log, const std::vector<std::string>& formats);

/// Notes if rays cross space, or meet sides of actors, that the log did not observe.
/// @param scan_json_entries entries of scans.json
void note_unobserved(const std::vector<std::string>& scan_json_entries, const std::string& scan_folder);

/// Returns the parts of the help of `relidar render` that describe files and channels.
std::string render_output_help();
std::string render_channels_help();

}  // namespace relidar::cli
