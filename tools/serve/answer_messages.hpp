// SPDX-License-Identifier: Apache-2.0
// Converts rendered scans and descriptions of scenes to Protobuf messages.
#pragma once

#include <relidar/simulate/assets.hpp>

#include "request_messages.hpp"
#include "spawned.hpp"

namespace relidar::serve {

void write_scan(const RenderedScan& scan, const RenderRequest& request, const Config& config,
                v1::LidarScan& message);
void write_scan(const RenderedPoints& scan, const RenderRequest& request, v1::LidarScan& message);

void write_boxes(const RenderedScan& scan, const RenderRequest& request, const Run& run,
                 v1::LidarScan& message);

void write_scene(const std::string& scene_name, const Run& run, v1::Scene& message);

/// Writes the paths of a LiDAR and of actors in the world frame of the dataset.
/// @param actors if the list is empty, all actors are written
/// @throws RejectedRequest if an actor is unknown
void write_tracks(const Run& run, int lidar, const google::protobuf::RepeatedPtrField<std::string>& actors,
                  v1::GetTracksResponse& message);

void write_asset(const AssetDescription& asset, v1::Asset& message);

void write_spawned(const SpawnSlot& slot, const Run& run, v1::SpawnedActor& message);

void write_sparse_actors(const RenderRequest& request, v1::LidarScan& message);

}  // namespace relidar::serve
