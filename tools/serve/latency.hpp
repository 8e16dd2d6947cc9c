// SPDX-License-Identifier: Apache-2.0
// Measures the latency of a render service. Contains no gRPC types.
#pragma once

#include <cstddef>
#include <string>

namespace relidar::serve {

struct LatencyOptions {
    std::string address;  ///< HOST:PORT of a render service. The connection does not use TLS.
    /// Empty: the first scene of the service.
    std::string scene;
    /// Empty: the sensor of the log.
    std::string sensor;
    int clients = 1;
    int calls = 100;  ///< Total number of calls of all clients.
};

struct Percentiles {
    double p50 = 0.0, p99 = 0.0;
};

struct LatencyResult {
    std::string scene;
    Percentiles latency_ms;   ///< Time from sending a call until the client receives the response.
    Percentiles queued_ms;    ///< Part of the latency during which the call waited in the queue.
    Percentiles rendered_ms;  ///< Part of the latency during which the scan was rendered.
    double scans_per_s = 0.0;
    std::size_t rays = 0;  ///< Number of rays per scan.
    double points = 0.0;   ///< Mean number of points per scan.
};

LatencyResult measure_latency(const LatencyOptions& options);

}  // namespace relidar::serve
