// SPDX-License-Identifier: Apache-2.0
// Times of every kernel of a training iteration, of a rebuild and of a moved instance,
// through the public faces alone.
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

/// Milliseconds over the repetitions.
struct Spread {
    double p10 = 0.0;
    double median = 0.0;
    double p90 = 0.0;
};
/// @param samples  [n] at least one
Spread spread_of(std::vector<double> samples);

/// Milliseconds that have passed.
double ms_since(std::chrono::steady_clock::time_point start);

/// All launches of one kernel, or of a group of kernels, in one repetition.
struct BenchRow {
    std::string name;
    Spread ms;
};

/// Device memory, bytes.
struct BenchMemory {
    std::uint64_t scene = 0;     ///< parameters and records of the surfels, instance table
    std::uint64_t accel = 0;     ///< structures, proxies, scratch
    std::uint64_t training = 0;  ///< gradients and moments
    std::uint64_t rays = 0;      ///< rays, what they render, targets, loss gradients
    std::uint64_t peak = 0;      ///< since the device was opened
};

/// What a ray of the forward pass looks at, on average.
struct BenchVisits {
    double nodes = 0.0;
    double surfels = 0.0;
};

struct BenchResult {
    bool device_clock = true;  ///< false: wall time, forward alone
    std::string proxy;
    std::vector<BenchRow> kernels;               ///< in the order of an iteration
    std::vector<BenchRow> phases;                ///< rebuild, iteration, iteration_wall, move
    double forward_mrays_per_s = 0.0;            ///< median of diff/forward/trace
    std::optional<double> backward_mrays_per_s;  ///< median of diff/backward/trace
    double hits_per_ray = 0.0;                   ///< blended
    std::uint32_t kept_hits = 0;                 ///< of a ray, for the backward pass
    std::optional<BenchVisits> visits;           ///< software traversal alone
    BenchMemory memory;
    FloorSizes sizes;
    /// read and written together; of the device, not of the case: measure() leaves it out
    std::optional<double> copy_bytes_per_s;
};

struct BenchSettings {
    int repeat = 10;
    bool backward = true;
    bool quiet = false;
};

/// Warms up, then measures. Learning rates are 0, so that every repetition sees the same
/// scene.
/// @throws DeviceError where a ray reaches the cap of passes
BenchResult measure(Device& device, const DevCase& bench, const BenchSettings& settings);

}  // namespace relidar::cli
