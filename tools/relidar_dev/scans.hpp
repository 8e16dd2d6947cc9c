// SPDX-License-Identifier: Apache-2.0
// The command `relidar-dev bench --run RUN --scans N` measures how many scans per second
// are simulated. The time includes all steps from the pose to the finished scan.
#pragma once

#include <string>

namespace relidar {
class Device;
}

namespace relidar::cli {

struct ScanBench {
    int n_scans = 0;  ///< Number of scans to measure. 0 means that scans are not measured.
    /// Run folder and sensor. The sensor is a name of `relidar list sensors` or the file
    /// of a rig. An empty sensor means the sensor of the log.
    std::string run, sensor;
    /// Number of scans that are submitted together. 0 means one scan, or all scans of a
    /// rig.
    int together = 0;
    /// If true, ray drops and noise are random. If false, the most likely scan is
    /// computed.
    bool sampled = false;
};

struct ScanTimes {
    std::string sensor;
    int n_scans = 0;
    int together = 1;
    /// Number of the scans submitted together that the device renders in parallel.
    int side_by_side = 1;
    double rays = 0.0;    ///< Mean number of rays per scan.
    double points = 0.0;  ///< Mean number of returned points per scan.
    /// Number of scans per second. The measurement starts after the memory of the scans
    /// was allocated.
    double scans_per_s = 0.0;
    /// Median wall time of a group of scans that were submitted together, divided by
    /// their number.
    double scan_ms = 0.0;
    double device_ms = 0.0;  ///< Mean kernel time per scan. It is 0 if the device has no timestamps.
    double host_ms = 0.0;    ///< Mean processor time per scan that the calling thread uses.
};

/// Measures scans of a sensor or a rig that moves along the path of the log. The times of
/// the scans are evenly spaced between the first and the last sweep.
/// @throws UsageError if a number is out of range; DataError if the run or the rig cannot
/// be read
ScanTimes measure_scans(Device& device, const ScanBench& bench);

std::string scans_text(const ScanTimes& times);
std::string scans_json(const ScanTimes& times, const Device& device, const std::string& command_line);

}  // namespace relidar::cli
