// SPDX-License-Identifier: Apache-2.0
// Measures scenes with many copies of an actor. Measures three operations: rendering a
// scan, a training step, and moving all copies.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "measure.hpp"

namespace relidar::cli {

/// Results of a benchmark: times and memory for a scene with `n_actors` copies of an
/// actor. Each copy has kActorSurfels surfels. The sensor has 64 x 1024 rays.
struct ActorBenchTimes {
    int n_actors = 0;
    /// True: each actor has its own model, and spherical harmonics (SH) are evaluated per
    /// surfel. False: actors share one model, and SH are evaluated per ray.
    bool copy_shared_models = false;
    /// Wall time of building the acceleration structure: all bottom levels and the top.
    double build_ms = 0.0;
    /// Wall time of uploading the poses and rebuilding the top level of the acceleration
    /// structure. Includes all waits.
    TimePercentiles move_ms{};
    /// number of builds and refits of bottom levels while the actors moved
    std::uint64_t builds = 0;
    TimePercentiles scan_ms{};
    TimePercentiles step_ms{};  ///< Wall time of a training iteration.
    std::uint64_t memory = 0;   ///< Device memory during training, in bytes.

    std::uint64_t n_surfels() const;
};
inline constexpr std::uint32_t kActorSurfels = 1000;

/// Measures build, rendering and training times of a scene with many actors.
/// @param copy_shared_models see ActorBenchTimes
/// @throws DeviceError if a ray needs more search passes than allowed, or if the device
/// has no timestamps
ActorBenchTimes measure_actors(Device& device, int n_actors, bool copy_shared_models,
                               const BenchSettings& settings);

/// Returns a table with a row for each benchmark.
std::string format_actors(const std::vector<ActorBenchTimes>& times);

}  // namespace relidar::cli
