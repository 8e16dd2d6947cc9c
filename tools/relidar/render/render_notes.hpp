// SPDX-License-Identifier: Apache-2.0
#pragma once

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

/// Notes if rays cross space, or meet sides of actors, that the log did not observe.
/// @param scan_json_entries entries of scans.json
void note_unobserved(const std::vector<std::string>& scan_json_entries, const std::string& scan_folder);

}  // namespace relidar::cli
