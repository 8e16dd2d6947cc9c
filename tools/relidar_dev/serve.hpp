// SPDX-License-Identifier: Apache-2.0
// Implements the command `relidar-dev bench --serve`. Measures how long clients of a
// running service wait for a scan.
#pragma once

#include <string>

namespace relidar::cli {

struct ServeBenchOptions {
    std::string address;  ///< address of the service; if it is empty, no service is measured
    std::string scene, sensor;
    int clients = 1;
    int calls = 100;
};

/// Measures a service and prints the latencies and the scans per second.
/// @throws UsageError if this program was built without gRPC
/// @throws DataError if no server answers
void bench_service(const ServeBenchOptions& options);

}  // namespace relidar::cli
