// SPDX-License-Identifier: Apache-2.0
// Assets and spawned actors as messages.
#pragma once

#include <relidar/simulate/assets.hpp>
#include <relidar/simulate/render.hpp>

#include "relidar/v1/render.pb.h"
#include "request_messages.hpp"
#include "spawned.hpp"

namespace relidar::serve {

void write_asset(const AssetFacts& facts, v1::Asset& message);

/// @param run  of the scene, without surfels
void write_spawned(const SpawnedActors::Place& place, const Run& run, v1::SpawnedActor& message);

/// Says which actors that the request placed are too coarse for where they stand.
void write_sparse_actors(const WantedScan& wanted, v1::LidarScan& message);

}  // namespace relidar::serve
