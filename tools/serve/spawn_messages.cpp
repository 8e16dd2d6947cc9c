// SPDX-License-Identifier: Apache-2.0
#include "spawn_messages.hpp"

#include <relidar/run/edit.hpp>

#include "geometry_messages.hpp"

namespace relidar::serve {

void write_asset_into_message(const AssetDescription& asset_description, v1::Asset& message) {
    message.set_name(asset_description.name);
    message.set_category(asset_description.category);
    message.set_kind(get_name(asset_description.kind));
    write_vector(asset_description.size_m, *message.mutable_size_m());
    message.set_score(asset_description.get_observed_or_mirrored_surface_fraction());
    message.set_seen(asset_description.seen);
    message.set_nearest_m(asset_description.nearest_m);
    message.set_surfels(asset_description.surfels);
    message.set_sensor(asset_description.sensor);
}

void write_spawned_actor(const SpawnedActorRegistry::SpawnSlot& slot, const TrainedRun& run,
                         v1::SpawnedActor& message) {
    message.set_name(slot.actor.name);
    if (slot.actor.source.is_asset) message.set_asset(slot.actor.source.name);
    else message.set_actor(slot.actor.source.name);
    message.set_instance(std::uint32_t(run.scene.instances.size() + slot.position));
    write_vector(slot.actor.size_m, *message.mutable_size_m());
    message.set_surfels(slot.actor.surfels);
}

void write_actors_with_too_few_surfels(const RenderRequest& request, v1::LidarScan& message) {
    if (request.placed.empty()) return;
    const SimulatedSensor& sensor = *request.sensor;
    const double time_s = request.request.time_s;
    // The rays are computed here if they change from scan to scan.
    const bool makes_rays = sensor.pattern && sensor.rays.size() == 0;
    const RayTable made = makes_rays ? make_rays(*sensor.pattern, time_s) : RayTable{};
    const RayTable& rays = makes_rays ? made : sensor.rays;
    const Pose dataset_from_sensor = request.request.dataset_from_sensor.interpolate_pose(time_s);
    for (const VisibleActor& actor : request.placed) {
        const Pose dataset_from_actor =
            request.request.dataset_from_actor->at(actor.track).interpolate_pose(time_s);
        const Pose box_from_sensor = inverse(dataset_from_actor) * dataset_from_sensor;
        const ActorModelResolution detail = compute_actor_model_resolution(
            rays.origin, rays.direction, box_from_sensor, actor.size_m, actor.surfels);
        if (!detail.has_too_few_surfels()) continue;
        v1::SparseActor& sparse = *message.add_sparse_actors();
        sparse.set_name(actor.name);
        sparse.set_distance_m(detail.nearest_m);
        sparse.set_rays(detail.rays);
        sparse.set_surfels(detail.surfels);
    }
}

}  // namespace relidar::serve
