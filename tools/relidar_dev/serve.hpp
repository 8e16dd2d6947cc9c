// SPDX-License-Identifier: Apache-2.0
// `relidar-dev bench --serve`: measures the latency of a running service for its clients.
#pragma once

#include <string>

namespace relidar::cli {

struct ServeBench {
    std::string address;  ///< Address of the service. Empty: no service is measured.
    std::string scene, sensor;
    int clients = 1;
    int calls = 100;
};

/// Prints latencies and scans per second.
/// @throws UsageError if this program was built without the service; DataError if no
/// server answers
void bench_service(const ServeBench& bench);

}  // namespace relidar::cli
