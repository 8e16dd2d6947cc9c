// SPDX-License-Identifier: Apache-2.0
// Converts assets and spawned actors to messages.
#pragma once

#include <span>

#include <relidar/simulate/assets.hpp>
#include <relidar/simulate/render.hpp>

#include "relidar/v1/render.pb.h"
#include "request_messages.hpp"
#include "spawned.hpp"

namespace relidar::serve {

void write_asset(const AssetFacts& facts, v1::Asset& message);

/// Writes a spawned actor.
/// @param run run of the scene, without surfels
void write_spawned(const SpawnedActors::Place& place, const Run& run, v1::SpawnedActor& message);

/// [n] rays of a scan in the sensor frame.
struct RaysOfScan {
    std::span<const glm::vec3> origin, direction;
};
/// Lists the actors placed by the request that have too few surfels for their distance
/// from the sensor.
void write_sparse_actors(const WantedScan& wanted, const RaysOfScan& rays, v1::LidarScan& message);

}  // namespace relidar::serve
