// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

#include "options.hpp"

namespace relidar::cli {

struct BenchOptions {
    std::string run;     ///< Folder of the run. Empty = benchmark street.
    std::string sensor;  ///< Sensor or rig whose scans are measured. Empty = the log's sensor.
    std::string json;    ///< File for the report. Empty = none.
    DeviceCommandOptions device;
};

/// Measures and prints the speed of the device with a run or the benchmark street.
void run_bench(const BenchOptions& options);

}  // namespace relidar::cli
