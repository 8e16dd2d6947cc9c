// SPDX-License-Identifier: Apache-2.0
// Converts rendered scans and descriptions of scenes to Protobuf messages.
#pragma once

#include <relidar/run/run.hpp>
#include <relidar/simulate/assets.hpp>
#include <relidar/simulate/render.hpp>

#include "relidar/v1/render.pb.h"
#include "request_messages.hpp"
#include "spawned.hpp"

namespace relidar::serve {

void write_scan_into_message(const RenderedScan& scan, const RenderRequest& request,
                             const Config& config_with_range_limits, v1::LidarScan& message);
void write_scan_into_message(const RenderedPoints& scan, const RenderRequest& request,
                             v1::LidarScan& message);

/// @param run_with_actors may have no surfels
void write_actor_boxes_into_message(const RenderedScan& scan, const RenderRequest& request,
                                    const TrainedRun& run_with_actors, v1::LidarScan& message);

void write_scene_description(const std::string& scene_name, const TrainedRun& run, v1::Scene& message);

/// In the world frame of the dataset.
/// @param actor_names_or_all if the list is empty, all actors are written
/// @throws RejectedRequest if an actor is unknown
void write_recorded_tracks(const TrainedRun& run, int lidar_index,
                           const google::protobuf::RepeatedPtrField<std::string>& actor_names_or_all,
                           v1::GetTracksResponse& message);

void write_asset_into_message(const AssetDescription& asset_description, v1::Asset& message);

void write_spawned_actor(const SpawnedActorRegistry::SpawnSlot& slot, const TrainedRun& run,
                         v1::SpawnedActor& message);

void write_actors_with_too_few_surfels(const RenderRequest& request, v1::LidarScan& message);

}  // namespace relidar::serve
