// SPDX-License-Identifier: Apache-2.0
// What moving actors costs: the top level alone, however many surfels they have.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "bench_measure.hpp"

namespace relidar::cli {

/// So many actors of kActorSurfels surfels each, every one with a model of its own, all moved at once.
struct ActorMoves {
    int n_actors = 0;
    double build_ms = 0.0;       ///< wall time: all bottom levels and the top level, once
    Spread move_ms;              ///< wall time: poses to the device and top level, waits included
    std::uint64_t builds = 0;    ///< bottom-level builds and refits recorded during all the moves
};
inline constexpr std::uint32_t kActorSurfels = 10000;

ActorMoves measure_moves(Device& device, int n_actors, int repeat);

std::string moves_text(const std::vector<ActorMoves>& moves);
std::string moves_json(const std::vector<ActorMoves>& moves, const Device& device, const std::string& command_line);

}  // namespace relidar::cli
