// SPDX-License-Identifier: Apache-2.0
// `relidar bench --run RUN --scans N`: scans a second that a simulation gets from a run, poses in, scans out.
#pragma once

#include <string>

namespace relidar {
class Device;
}

namespace relidar::cli {

struct ScanBench {
    int n_scans = 0;          ///< 0: not asked for
    std::string run, sensor;  ///< one of `relidar sensors`; empty: the log's own
    bool sampled = false;     ///< drawn by seeds, instead of the likeliest
};

struct ScanTimes {
    std::string sensor;
    int n_scans = 0;
    std::size_t rays = 0;
    double points = 0.0;        ///< returned, mean of a scan
    double scans_per_s = 0.0;   ///< of all together, after one to warm up
    double scan_ms = 0.0;       ///< median wall time of a scan
    double device_ms = 0.0;     ///< of it kernels, mean; 0 without timestamps
    double host_ms = 0.0;       ///< processor time of the calling thread, mean
};

/// Drives a sensor along the log's own way, evenly spaced between the middles of its first and last sweep.
/// @throws UsageError for a number of scans out of range, DataError for a run that cannot be read
ScanTimes measure_scans(Device& device, const ScanBench& bench);

std::string scans_text(const ScanTimes& times);
std::string scans_json(const ScanTimes& times, const Device& device, const std::string& command_line);

}  // namespace relidar::cli
