// SPDX-License-Identifier: Apache-2.0
// Measures the time of every kernel of a training iteration, of a rebuild and of moving
// an instance. Uses only public interfaces.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "floor.hpp"

namespace relidar {
class Device;
}

namespace relidar::cli {

struct DevCase;

/// Percentiles in milliseconds over the repetitions.
struct Spread {
    double p10 = 0.0;
    double median = 0.0;
    double p90 = 0.0;
};
/// Computes the percentiles.
/// @param samples [n], at least one
Spread spread_of(std::vector<double> samples);

/// Returns the milliseconds since `start`.
double ms_since(std::chrono::steady_clock::time_point start);

/// Total time of all launches of a kernel, or of a group of kernels, in one repetition.
struct BenchRow {
    std::string name;
    Spread ms;
};

/// Device memory in bytes.
struct BenchMemory {
    std::uint64_t scene = 0;     ///< Parameters and records of the surfels, and the instance table.
    std::uint64_t accel = 0;     ///< Acceleration structures, proxies and scratch memory.
    std::uint64_t training = 0;  ///< Gradients and moments of Adam.
    std::uint64_t rays = 0;      ///< Rays, rendered values, targets and loss gradients.
    std::uint64_t peak = 0;      ///< Peak since the device was opened.
};

/// Mean number of nodes and surfels that a ray of the forward pass visits.
struct BenchVisits {
    double nodes = 0.0;
    double surfels = 0.0;
};

struct BenchResult {
    bool device_clock = true;  ///< False: wall time of the forward pass only.
    std::string proxy;
    std::vector<BenchRow> kernels;               ///< In the order of an iteration.
    std::vector<BenchRow> phases;                ///< "rebuild", "iteration", "iteration_wall" and "move".
    double forward_mrays_per_s = 0.0;            ///< From the median time of diff/forward/trace.
    std::optional<double> backward_mrays_per_s;  ///< From the median time of diff/backward/trace.
    double hits_per_ray = 0.0;                   ///< Mean number of blended hits.
    std::uint32_t kept_hits = 0;                 ///< Number of hits stored per ray for the backward pass.
    std::optional<BenchVisits> visits;           ///< No value for ray query.
    BenchMemory memory;
    FloorSizes sizes;
    /// Copy bandwidth, bytes read plus bytes written. It is a property of the device, so
    /// measure() does not set it.
    std::optional<double> copy_bytes_per_s;
};

struct BenchSettings {
    int repeat = 10;
    bool backward = true;
    bool quiet = false;
};

/// Warms up the device, then measures. Learning rates are 0, so that every repetition has
/// the same scene.
/// @throws DeviceError if a ray reaches the limit of passes
BenchResult measure(Device& device, const DevCase& bench, const BenchSettings& settings);

}  // namespace relidar::cli
