// SPDX-License-Identifier: Apache-2.0
// Notes that `relidar render` prints about its scans.
#pragma once

#include <string>
#include <vector>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar::cli {

/// Prints a note if the log is motion-compensated. Rendered scans of the log's sensor
/// then have no rolling shutter.
void note_compensated(const Run& run, const SensorChoice& sensor);

/// Prints a note if the ray-drop network of the run cannot be used for the scans of this
/// sensor.
void note_unrefined(const Run& run, const ScanRenderer& renderer, const SensorChoice& sensor);

/// Prints a note if sampled intensities have no noise. The reason is that the noise of
/// the LiDAR's intensities was not measured.
void note_unscattered(const Run& run, int lidar);

/// Prints a note that lists the sensor properties that the simulation of weather assumes.
void note_weather(const Weather& weather);

/// Prints a note about scans in which many rays cross space that the log has not seen.
/// Prints another note about rays that meet a side of an actor that the log has not seen.
/// @param entries entries of scans.json
void note_unseen(const std::vector<std::string>& entries, const std::string& folder);

}  // namespace relidar::cli
