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
void note_compensated_rays(const Run& run, const SensorChoice& sensor);

/// Prints a note if the ray-drop network of the run cannot process scans of this sensor.
void note_unrefined_drops(const Run& run, const ScanRenderer& renderer, const SensorChoice& sensor);

/// Prints a note if the rendered intensities have no noise, because the noise of this
/// LiDAR's intensities was not measured.
void note_unscattered_intensities(const Run& run, int lidar);

/// Prints a note with the sensor properties that the weather simulation assumes.
void note_weather(const Weather& weather);

/// Prints a note about scans in which many rays cross space that the log has not
/// observed. Prints another note about rays that hit a side of an actor that the log has
/// not observed.
/// @param entries entries of scans.json
void note_unseen_regions(const std::vector<std::string>& entries, const std::string& folder);

}  // namespace relidar::cli
