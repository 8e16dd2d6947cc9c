// SPDX-License-Identifier: Apache-2.0
// `relidar-dev bench --run RUN --scans N`: scans a second that a simulation gets from a
// run, poses in, scans out.
#pragma once

#include <string>

namespace relidar {
class Device;
}

namespace relidar::cli {

struct ScanBench {
    int n_scans = 0;  ///< 0: no scans are timed
    /// sensor: a name of `relidar list sensors` or the file of a rig; empty: the log's
    /// sensor
    std::string run, sensor;
    int together = 0;      ///< number of scans that are submitted together; 0: one, or all of a rig
    bool sampled = false;  ///< drawn by seeds instead of the likeliest
};

struct ScanTimes {
    std::string sensor;
    int n_scans = 0;
    int together = 1;
    int side_by_side = 1;      ///< of those that are together
    double rays = 0.0;         ///< mean of a scan
    double points = 0.0;       ///< returned, mean of a scan
    double scans_per_s = 0.0;  ///< of all, once memory has been found for them
    double scan_ms = 0.0;      ///< median wall time of those that go to the device at once, over their number
    double device_ms = 0.0;    ///< of it kernels, mean; 0 without timestamps
    double host_ms = 0.0;      ///< processor time of the calling thread, mean
};

/// Drives a sensor, or a rig, along the log's own way, evenly spaced between the middles
/// of its first and last sweep.
/// @throws UsageError for numbers out of range, DataError for a run or rig that cannot be
/// read
ScanTimes measure_scans(Device& device, const ScanBench& bench);

std::string scans_text(const ScanTimes& times);
std::string scans_json(const ScanTimes& times, const Device& device, const std::string& command_line);

}  // namespace relidar::cli
