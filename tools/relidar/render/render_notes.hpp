// SPDX-License-Identifier: Apache-2.0
// Notes that `relidar render` prints about its scans.
#pragma once

#include <string>
#include <vector>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar::cli {

/// Prints a note if the log is motion-compensated. In this case, scans of the log's
/// sensor are rendered without rolling shutter.
void print_note_if_log_is_motion_compensated(const TrainedRun& run, const SimulatedSensor& sensor);

/// Prints a note if the ray-drop network of the run cannot process scans of this sensor.
void print_note_if_drop_network_is_unused(const TrainedRun& run, const ScanRenderer& renderer,
                                          const SimulatedSensor& sensor);

/// Prints a note if the rendered intensities have no noise, because the noise of this
/// LiDAR's intensities was not measured.
void print_note_if_intensity_noise_missing(const TrainedRun& run, int lidar_index);

/// Prints a note with the sensor properties that the weather simulation assumes.
void print_sensor_assumptions_of_weather(const Weather& weather);

/// Prints a note about scans in which many rays cross space that the log has not
/// observed. Prints another note about rays that hit a side of an actor that the log has
/// not observed.
/// @param scan_json_entries entries of scans.json
void print_note_on_unseen_space(const std::vector<std::string>& scan_json_entries,
                                const std::string& scan_folder);

}  // namespace relidar::cli
