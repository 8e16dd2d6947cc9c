// SPDX-License-Identifier: Apache-2.0
// What `relidar render` has to say of its scans beside the scans themselves.
#pragma once

#include <string>
#include <vector>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar::cli {

/// Says that scans of the log's sensor have no rolling shutter, because the log is
/// motion-compensated.
void note_compensated(const Run& run, const SensorChoice& sensor);

/// Says that the run's network does not fit the scans of a sensor, where it does not.
void note_unrefined(const Run& run, const ScanRenderer& renderer, const SensorChoice& sensor);

/// Says that sampled intensities are the likeliest, where nothing is known of how those
/// of a LiDAR scatter.
void note_unscattered(const Run& run, int lidar);

/// Says what is taken for granted of sensors in weather.
void note_weather(const Weather& weather);

/// Says which scans look where the log has not looked. @param entries  of scans.json
void note_unseen(const std::vector<std::string>& entries, const std::string& folder);

}  // namespace relidar::cli
