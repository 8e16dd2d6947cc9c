// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>

namespace relidar::cli {

void note_sensor(const Run& run, const ScanRenderer& renderer, const SimulatedSensor& sensor);

void note_missing_noise(const Run& run, int lidar);

void note_time_shift(const Log& log, std::int64_t time_shift_ns);

void note_weather(const Weather& weather);

/// Unobserved space, and unobserved sides of actors.
/// @param scan_json_entries entries of scans.json
void note_unobserved(const std::vector<std::string>& scan_json_entries, const std::string& scan_folder);

}  // namespace relidar::cli
