// SPDX-License-Identifier: Apache-2.0
#include "spawn_messages.hpp"

#include <relidar/run/edit.hpp>

#include "geometry_messages.hpp"

namespace relidar::serve {

void write_asset(const AssetDescription& facts, v1::Asset& message) {
    message.set_name(facts.name);
    message.set_category(facts.category);
    message.set_kind(get_name(facts.kind));
    write_vector(facts.size_m, *message.mutable_size_m());
    message.set_score(facts.compute_covered_fraction());
    message.set_seen(facts.seen);
    message.set_nearest_m(facts.nearest_m);
    message.set_surfels(facts.surfels);
    message.set_sensor(facts.sensor);
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

void write_names_of_sparse_actors(const RenderRequest& request, v1::LidarScan& message) {
    if (request.placed.empty()) return;
    const SimulatedSensor& sensor = *request.sensor;
    const double time_s = request.request.time_s;
    // True if the ray directions of the sensor change from scan to scan.
    const bool makes_rays = sensor.pattern && sensor.rays.size() == 0;
    const RayTable made = makes_rays ? make_rays(*sensor.pattern, time_s) : RayTable{};
    const RayTable& rays = makes_rays ? made : sensor.rays;
    const Pose dataset_from_sensor = request.request.dataset_from_sensor.interpolate_pose(time_s);
    for (const VisibleActor& actor : request.placed) {
        const Pose dataset_from_actor =
            request.request.dataset_from_actor->at(actor.track).interpolate_pose(time_s);
        const Pose box_from_sensor = inverse(dataset_from_actor) * dataset_from_sensor;
        const ActorModelResolution detail = measure_actor_resolution(
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
