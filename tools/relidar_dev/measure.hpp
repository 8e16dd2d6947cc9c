// SPDX-License-Identifier: Apache-2.0
// Measures the time of each kernel in three phases: a training iteration, building the
// acceleration structure, and moving an instance. Uses only public headers.
#pragma once

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

struct TimePercentiles {
    double p10 = 0.0;
    double median = 0.0;
    double p90 = 0.0;
};
/// Interpolates linearly between samples.
TimePercentiles percentiles_of(std::vector<double> samples);

struct KernelBenchTime {
    std::string name;
    TimePercentiles ms;
};

struct BenchMemory {
    /// Bytes of the surfel parameters, the surfel records and the instance table.
    std::uint64_t scene = 0;
    std::uint64_t accel = 0;     ///< Memory of acceleration structures, proxies and scratch buffers.
    std::uint64_t training = 0;  ///< Memory of the gradients and of the optimizer's moments (Adam).
    std::uint64_t rays = 0;      ///< Memory of rays, rendered values, targets and gradients of the loss.
    std::uint64_t peak = 0;      ///< Maximum device memory since the device was opened.
};
/// Returns the bytes that grow with the number of surfels.
inline std::uint64_t surfel_bytes(const BenchMemory& memory) {
    return memory.scene + memory.accel + memory.training;
}

struct BenchVisits {
    double nodes = 0.0;
    double surfels = 0.0;
};

struct BenchResult {
    std::string proxy;
    std::vector<KernelBenchTime> kernels;  ///< Times of the kernels, in the order of a training iteration.
    std::vector<KernelBenchTime> phases;
    /// Speed of the forward pass in million rays per second, from the median times of the
    /// kernels diff/forward/*.
    double forward_mrays_per_s = 0.0;
    /// Speed of the backward pass in million rays per second, from the median time of the
    /// kernel diff/backward/trace.
    std::optional<double> backward_mrays_per_s;
    double hits_per_ray = 0.0;              ///< Mean number of hits that are blended per ray.
    std::uint32_t stored_hits_per_ray = 0;  ///< Number of hits that are stored per ray for the backward pass.
    std::optional<BenchVisits> visits;
    BenchMemory memory;
    MemoryTrafficSizes sizes;
    /// Copy bandwidth of the device: bytes read plus bytes written per second. Not set by
    /// run_benchmark(), because it does not depend on the benchmark.
    std::optional<double> copy_bytes_per_s;
};

struct BenchSettings {
    int repeat = 10;
    bool backward = true;
    bool quiet = false;
};

/// Warms up the device and then measures all kernels. The learning rates are 0, so that
/// the scene is the same in every repetition.
/// @throws DeviceError if a ray needs more search passes than allowed, or if the device
/// has no timestamps
BenchResult run_benchmark(Device& device, const DevCase& setup, const BenchSettings& settings);

/// The results as text for the terminal: settings, table of times, speed and memory.
std::string format_result(const DevCase& setup, const BenchResult& result, const Device& device);
/// The results for --json.
/// @param args command line
std::string result_json(const DevCase& setup, const BenchSettings& settings, const BenchResult& result,
                        const Device& device, const std::string& args);

}  // namespace relidar::cli
