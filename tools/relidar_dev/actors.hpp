// SPDX-License-Identifier: Apache-2.0
// Measures the cost of many copies of an actor: rendering a scan, a training step, and
// moving all copies.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "measure.hpp"

namespace relidar::cli {

/// Results for `n_actors` copies of an actor with kActorSurfels surfels around a sensor
/// of 64 x 1024 rays.
struct ActorTimes {
    int n_actors = 0;
    /// True: each actor has its own model, and harmonics are evaluated once per surfel.
    /// False: all actors share one model, and harmonics are evaluated along each ray.
    bool own_models = false;
    double build_ms = 0.0;     ///< Wall time to build all bottom levels and the top level once.
    Spread move_ms{};          ///< Wall time to upload poses and rebuild the top level, including waits.
    std::uint64_t builds = 0;  ///< Number of bottom-level builds and refits recorded during all moves.
    Spread scan_ms{};          ///< Wall time of activation, refit and forward pass.
    Spread step_ms{};          ///< Wall time of a training iteration.
    std::uint64_t memory = 0;  ///< Bytes of device memory while training.

    std::uint64_t n_surfels() const;
};
inline constexpr std::uint32_t kActorSurfels = 1000;

/// Measures all times.
/// @throws DeviceError if a ray reaches the limit of passes, or the device has no
/// timestamps
ActorTimes measure_actors(Device& device, int n_actors, bool own_models, const BenchSettings& settings);

std::string actors_text(const std::vector<ActorTimes>& times);
std::string actors_json(const std::vector<ActorTimes>& times, const Device& device,
                        const std::string& command_line);

}  // namespace relidar::cli
