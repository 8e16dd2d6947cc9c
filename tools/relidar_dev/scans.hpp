// SPDX-License-Identifier: Apache-2.0
// `relidar-dev bench --run RUN --scans N`: measures the scans per second of a simulation,
// from poses to finished scans.
#pragma once

#include <string>

namespace relidar {
class Device;
}

namespace relidar::cli {

struct ScanBench {
    int n_scans = 0;  ///< 0: scans are not measured.
    /// Run folder; and sensor as a name of `relidar list sensors` or the file of a rig.
    /// Empty sensor: the log's sensor.
    std::string run, sensor;
    int together = 0;      ///< Number of scans that are submitted together. 0: one, or all scans of a rig.
    bool sampled = false;  ///< True: scans are drawn with random seeds. False: the most likely scan.
};

struct ScanTimes {
    std::string sensor;
    int n_scans = 0;
    int together = 1;
    int side_by_side = 1;      ///< Number of those scans that the device renders in parallel.
    double rays = 0.0;         ///< Mean number of rays per scan.
    double points = 0.0;       ///< Mean number of returned points per scan.
    double scans_per_s = 0.0;  ///< Rate over all scans, measured after their memory was allocated.
    /// Median wall time of a group of submitted scans, divided by the size of the group.
    double scan_ms = 0.0;
    double device_ms = 0.0;  ///< Mean kernel time per scan. 0 without timestamps.
    double host_ms = 0.0;    ///< Mean processor time of the calling thread per scan.
};

/// Moves a sensor or a rig along the log's path. Scan times are evenly spaced between the
/// middle of the first and of the last sweep.
/// @throws UsageError for numbers out of range; DataError if the run or the rig cannot be
/// read
ScanTimes measure_scans(Device& device, const ScanBench& bench);

std::string scans_text(const ScanTimes& times);
std::string scans_json(const ScanTimes& times, const Device& device, const std::string& command_line);

}  // namespace relidar::cli
