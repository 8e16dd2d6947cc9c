// SPDX-License-Identifier: Apache-2.0
// Converts sweeps whose firings are known to scans.
#pragma once

#include <algorithm>
#include <vector>

#include <relidar/read/clouds.hpp>

#include "base/progress_blocks.hpp"

namespace relidar::read {

struct FiredSweep {
    /// with rings and firings, in the frame of the LiDAR at the time of each point
    LidarPoints points;
    SweepFirings sweep;
};

/// Sets the columns of all LiDARs and the scans of all frames. The columns are symmetric
/// to the front.
/// @param sweeps  [frames] released; a sweep without points is broken and gets no scan
inline void set_fired_scans(Log& log, std::vector<FiredSweep>& sweeps, const Progress& progress) {
    for (std::size_t i = 0; i < sweeps.size(); ++i) {
        SpinningSensor& sensor = log.lidars[std::size_t(log.frames[i].lidar)].sensor;
        sensor.columns = std::max(sensor.columns, int(sweeps[i].sweep.firings.size()));
    }
    for (Lidar& lidar : log.lidars) lidar.sensor.first_azimuth_rad = kPi - kPi / lidar.sensor.columns;
    progress_for(sweeps.size(), progress, "assigning points to the fired rays", [&](std::size_t i) {
        Frame& frame = log.frames[i];
        if (const auto& [points, sweep] = sweeps[i]; points.size() > 0)
            frame.scan = spinning_scan(points, log.lidar_of(frame).sensor, sweep);
        sweeps[i] = {};
    });
}

}  // namespace relidar::read
