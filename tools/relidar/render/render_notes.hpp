// SPDX-License-Identifier: Apache-2.0
// Notes that `relidar render` prints about its scans.
#pragma once

#include <string>
#include <vector>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar::cli {

/// Prints a note if scans of the log's sensor have no rolling shutter because the log is
/// motion-compensated.
void note_compensated(const Run& run, const SensorChoice& sensor);

/// Prints a note if the run's ray-drop network does not fit the scans of a sensor.
void note_unrefined(const Run& run, const ScanRenderer& renderer, const SensorChoice& sensor);

/// Prints a note if sampled intensities have no noise, because the run does not know how
/// the intensities of the LiDAR scatter.
void note_unscattered(const Run& run, int lidar);

/// Prints a note about assumed sensor properties in simulated weather.
void note_weather(const Weather& weather);

/// Prints a note about scans that look into space that the log has not seen.
/// @param entries entries of scans.json
void note_unseen(const std::vector<std::string>& entries, const std::string& folder);

}  // namespace relidar::cli
