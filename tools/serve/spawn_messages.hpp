// SPDX-License-Identifier: Apache-2.0
// Converts assets and actors that clients have added to Protobuf messages.
#pragma once

#include <relidar/simulate/assets.hpp>
#include <relidar/simulate/render.hpp>

#include "relidar/v1/render.pb.h"
#include "request_messages.hpp"
#include "spawned.hpp"

namespace relidar::serve {

void write_asset_into_message(const AssetDescription& asset_description, v1::Asset& message);

void write_spawned_actor(const SpawnedActorRegistry::SpawnSlot& slot, const TrainedRun& run,
                         v1::SpawnedActor& message);

void write_actors_with_too_few_surfels(const RenderRequest& request, v1::LidarScan& message);

}  // namespace relidar::serve
