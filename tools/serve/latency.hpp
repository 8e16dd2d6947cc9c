// SPDX-License-Identifier: Apache-2.0
// Measures how long clients wait for scans of a service along the log's path. This header
// uses no type of gRPC.
#pragma once

#include <cstddef>
#include <string>

namespace relidar::serve {

struct LatencyOptions {
    std::string address;  ///< HOST:PORT of a service without TLS.
    std::string scene;    ///< Name of the scene. Empty: the first scene.
    std::string sensor;   ///< Name of the sensor. Empty: the sensor of the log.
    int clients = 1;      ///< Number of clients. Each has a separate connection and makes one call at a time.
    int calls = 100;      ///< Total number of calls of all clients.
};

/// Median and 99th percentile in milliseconds.
struct Percentiles {
    double p50 = 0.0, p99 = 0.0;
};

struct LatencyResult {
    std::string scene;
    Percentiles latency_ms;   ///< Time from the call to its answer, as measured by the client.
    Percentiles queued_ms;    ///< Part of this time spent waiting for the device.
    Percentiles rendered_ms;  ///< Part of this time spent rendering.
    double scans_per_s = 0.0;
    std::size_t rays = 0;  ///< Number of rays per scan.
    double points = 0.0;   ///< Mean number of points per scan.
};

/// Measures the latency.
/// @throws DataError if the service does not answer or rejects a call
LatencyResult measure_latency(const LatencyOptions& options);

}  // namespace relidar::serve
