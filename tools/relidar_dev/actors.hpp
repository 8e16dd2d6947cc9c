// SPDX-License-Identifier: Apache-2.0
// What many copies of an actor cost: a scan, a training step, and moving all of them.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "measure.hpp"

namespace relidar::cli {

/// So many copies of an actor of kActorSurfels surfels around a sensor of 64 x 1024 rays.
struct ActorTimes {
    int n_actors = 0;
    /// a model each, harmonics once a surfel; else one model for all, harmonics along the
    /// ray
    bool own_models = false;
    double build_ms = 0.0;     ///< wall time: all bottom levels and the top level, once
    Spread move_ms{};          ///< wall time: poses to the device and top level, waits included
    std::uint64_t builds = 0;  ///< bottom-level builds and refits recorded during all the moves
    Spread scan_ms{};          ///< wall time: activation, refit, forward
    Spread step_ms{};          ///< wall time: a training iteration
    std::uint64_t memory = 0;  ///< bytes on the device while training

    std::uint64_t n_surfels() const;
};
inline constexpr std::uint32_t kActorSurfels = 1000;

/// @throws DeviceError where a ray reaches the cap of passes, or without timestamps
ActorTimes measure_actors(Device& device, int n_actors, bool own_models, const BenchSettings& settings);

std::string actors_text(const std::vector<ActorTimes>& times);
std::string actors_json(const std::vector<ActorTimes>& times, const Device& device,
                        const std::string& command_line);

}  // namespace relidar::cli
