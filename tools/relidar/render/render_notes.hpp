// SPDX-License-Identifier: Apache-2.0
// Notes that `relidar render` prints about its scans.
#pragma once

#include <string>
#include <vector>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>

namespace relidar::cli {

/// Prints a note if the log is motion-compensated, because scans of its sensor are then
/// rendered without rolling shutter. Prints another note if the ray-drop network of the
/// run cannot process scans of this sensor.
void print_notes_on_sensor(const TrainedRun& run, const ScanRenderer& renderer,
                           const SimulatedSensor& sensor);

/// Prints a note if sampled ranges or intensities have no noise, because training did not
/// measure the noise of this LiDAR.
void print_notes_on_missing_noise_models(const TrainedRun& run, int lidar_index);

/// Prints a note if points in the world frame are far from its origin, because they are
/// written in single precision.
/// @param dataset_from_sensor  path of the sensor; empty: the path of the log
void print_rounding_note(const TrainedRun& run, const PoseTrack& dataset_from_sensor,
                         PointCoordinateFrame frame);
/// Prints a note if time stamps of recordings and packets differ from the times and the
/// date of the log.
void print_note_on_time_shift(const LidarSequence& log, std::int64_t time_shift_ns);

/// Prints a note with the sensor properties that the weather simulation assumes.
void print_sensor_properties_assumed_for_weather(const Weather& weather);

/// Prints a note about scans in which many rays cross space that the log has not
/// observed. Prints another note about rays that hit a side of an actor that the log has
/// not observed.
/// @param scan_json_entries entries of scans.json
void print_note_on_unobserved_space(const std::vector<std::string>& scan_json_entries,
                                    const std::string& scan_folder);

}  // namespace relidar::cli
