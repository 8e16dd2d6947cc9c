// SPDX-License-Identifier: Apache-2.0
// Implements the command `relidar-dev bench --run RUN` with --scans and --steps. Measures
// how many scans per second are simulated, from the pose to the finished scan, and the
// time of training steps with the time between kernels.
#pragma once

#include <string>

#include "train/time_steps.hpp"

namespace relidar::cli {

struct ScanBenchOptions {
    int n_scans = 0;  ///< Number of scans to measure. 0 means that scans are not measured.
    /// Run folder and sensor. The sensor is a name of `relidar list sensors` or the path
    /// of a rig file. If the sensor is empty, the sensor of the log is used.
    std::string run, sensor;
    /// Number of scans that are submitted to the device together. 0 selects the default:
    /// one scan, or for a rig, one scan of each of its sensors.
    int together = 0;
};

struct ScanBenchTimes {
    std::string sensor;
    int n_scans = 0;
    int together = 1;
    int side_by_side = 1;
    double rays = 0.0;    ///< Mean number of rays per scan.
    double points = 0.0;  ///< Mean number of returned points per scan.
    /// number of scans per second, without the first scans, which allocate memory
    double scans_per_s = 0.0;
    /// Median wall time per scan. If scans are submitted in groups, the time of a group
    /// is divided by its size.
    double scan_ms = 0.0;
    double device_ms = 0.0;  ///< mean kernel time per scan, or 0 if the device has no timestamps
    double host_ms = 0.0;    ///< mean processor time per scan of the calling thread
};

/// Measures how long scans take to render. A sensor or a rig moves along the path of the
/// log. The scan times are evenly spaced between the first and the last sweep.
/// @throws UsageError if a number is out of range
/// @throws DataError if the run or the rig cannot be read
ScanBenchTimes measure_scans(Device& device, const ScanBenchOptions& options);

/// Returns speed and times per scan as text.
std::string format_scans(const ScanBenchTimes& times);

/// Measures training steps that continue a run.
TrainingStepTimes measure_steps(Device& device, const std::string& folder, int n_steps, bool quiet);
/// Returns the means per step as text: each kernel, the time between them, the total.
std::string format_steps(const TrainingStepTimes& times, const Device& device);

}  // namespace relidar::cli
