// SPDX-License-Identifier: Apache-2.0
// How long clients wait for scans of a service, along the log's own path. No type of gRPC
// here.
#pragma once

#include <cstddef>
#include <string>

namespace relidar::serve {

struct LatencyOptions {
    std::string address;  ///< HOST:PORT of a service without TLS
    std::string scene;    ///< empty: the first
    std::string sensor;   ///< a name; empty: the log's own
    int clients = 1;      ///< each with a connection of its own, one call at a time
    int calls = 100;      ///< of all clients together
};

/// Milliseconds that half, and all but one of a hundred, calls stay below.
struct Percentiles {
    double p50 = 0.0, p99 = 0.0;
};

struct LatencyResult {
    std::string scene;
    Percentiles latency_ms;   ///< from the call to its answer, as the client sees it
    Percentiles queued_ms;    ///< of that, waiting for the device
    Percentiles rendered_ms;  ///< and rendering
    double scans_per_s = 0.0;
    std::size_t rays = 0;  ///< of one scan
    double points = 0.0;   ///< of one scan, on average
};

/// @throws DataError where the service does not answer, or refuses a call
LatencyResult measure_latency(const LatencyOptions& options);

}  // namespace relidar::serve
