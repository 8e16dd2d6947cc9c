// SPDX-License-Identifier: Apache-2.0
#include "service.hpp"

#include <algorithm>

#include "answer_messages.hpp"
#include "asset_catalogue.hpp"
#include "render_requests.hpp"
#include "sensor_messages.hpp"

namespace relidar::serve {
namespace {

bool has_range_image(const RenderRequest& request) {
    return request.range_image || request.drop_probability || request.boxes || !request.points;
}

void write_times(const QueuedRequest& request, v1::LidarScan& answer) {
    answer.set_queued_ms(request.queued_ms());
    answer.set_rendered_ms(request.render_ms());
}

}  // namespace

/// Renders one scan with all values of its rays, and writes the requested parts to the
/// answer. Waits in the queue for the render thread.
void RenderService::render_scan(QueueSlot& slot, const RenderRequest& render_request,
                                const ServerContext& context, v1::LidarScan& answer) {
    ScanImageRequest request(scenes_, context, render_request);
    request.run_checked(slot);
    const Run& run = scenes_.runs()[render_request.scene];
    write_scan(request.scan, render_request, run.config, answer);
    if (render_request.boxes) write_boxes(request.scan, render_request, run, answer);
    write_sparse_actors(render_request, answer);
    write_times(request, answer);
}

/// Renders the points of several scans of the same scene together and writes the answers.
void RenderService::render_points(QueueSlot& slot, std::span<const RenderRequest> requests,
                                  const ServerContext& context, std::span<v1::LidarScan* const> answers) {
    PointsRequest request(scenes_, context, requests);
    request.run_checked(slot);
    for (std::size_t i = 0; i < requests.size(); ++i) {
        write_scan(request.points[i], requests[i], *answers[i]);
        write_sparse_actors(requests[i], *answers[i]);
        write_times(request, *answers[i]);
    }
}

/// Lists the scenes with their actors, and the assets and built-in sensors of the server.
Status RenderService::ListScenes(ServerContext*, const v1::ListScenesRequest*,
                                 v1::ListScenesResponse* answer) {
    return call_handler([&] {
        for (std::size_t i = 0; i < scenes_.runs().size(); ++i) {
            v1::Scene& scene = *answer->add_scenes();
            write_scene(scenes_.sources()[i].name, scenes_.runs()[i], scene);
            for (const SpawnSlot& slot : scenes_.spawned().list_occupied(i))
                write_spawned(slot, scenes_.runs()[i], *scene.add_spawned());
        }
        for (const AssetCatalogue::CatalogueEntry& entry : scenes_.assets().entries())
            write_asset(entry.facts, *answer->add_assets());
        for (const std::string& name : list_sensors()) answer->add_sensors(name);
    });
}

/// Writes the path of a LiDAR and of actors in the log.
Status RenderService::GetTracks(ServerContext*, const v1::GetTracksRequest* request,
                                v1::GetTracksResponse* answer) {
    return call_handler([&] {
        const std::size_t scene = reader_.find_scene(request->scene());
        const int lidar = reader_.find_lidar(scene, request->lidar());
        write_tracks(scenes_.runs()[scene], lidar, request->actors(), *answer);
    });
}

/// Adds actors to a scene, for all clients. The render thread loads them.
Status RenderService::SpawnActors(ServerContext* context, const v1::SpawnActorsRequest* request,
                                  v1::SpawnActorsResponse* answer) {
    return call_handler([&] {
        // Rejects the call here if too many calls are waiting.
        QueueSlot slot = reserve_slot(queue_);
        const std::size_t scene = reader_.find_scene(request->scene());
        const std::vector<ActorToSpawn> actors = reader_.read_spawn(*request, scene);
        SpawnRequest spawn(scenes_, *context, scene, actors);
        spawn.run_checked(slot);  // Waits for the render thread.
        for (const SpawnSlot& spawn_slot : spawn.occupied_slots)
            write_spawned(spawn_slot, scenes_.runs()[scene], *answer->add_actors());
    });
}

Status RenderService::DespawnActors(ServerContext*, const v1::DespawnActorsRequest* request,
                                    v1::DespawnActorsResponse* answer) {
    return call_handler([&] {
        const std::size_t scene = reader_.find_scene(request->scene());
        scenes_.spawned().remove_actors(scene, {request->names().begin(), request->names().end()});
        answer->set_left(std::uint32_t(scenes_.spawned().list_occupied(scene).size()));
    });
}

/// Stores a sensor of the client, who can use its handle in later requests.
Status RenderService::UploadSensor(ServerContext*, const v1::UploadSensorRequest* request,
                                   v1::UploadSensorResponse* answer) {
    return call_handler([&] {
        const auto [handle, sensor] = reader_.cache_sensor(request->sensor());
        const FiringTimeSpan span = firing_span(*sensor);
        answer->set_handle(handle);
        answer->set_rays(count_rays(*sensor));
        answer->set_first_ray_s(span.first_s);
        answer->set_last_ray_s(span.last_s);
        answer->set_kept(std::uint32_t(SensorCache::kMostSensors));
    });
}

/// Renders one scan.
Status RenderService::RenderLidar(ServerContext* context, const v1::RenderLidarRequest* request,
                                  v1::LidarScan* answer) {
    return call_handler([&] {
        // Rejects the call here if too many calls are waiting.
        QueueSlot slot = reserve_slot(queue_);
        const RenderRequest render_request = reader_.read_request(*request);
        // Points without an image can be rendered together with other requests.
        if (has_range_image(render_request)) render_scan(slot, render_request, *context, *answer);
        else render_points(slot, {&render_request, 1}, *context, {&answer, 1});
    });
}

/// Renders the scans of all sensors of a rig and sends each scan when it is ready.
/// Successive sensors that need only points are rendered together, up to kMostAtOnce. A
/// sensor that needs an image is rendered alone.
Status RenderService::RenderRig(ServerContext* context, const v1::RenderRigRequest* request,
                                grpc::ServerWriter<v1::RigScan>* writer) {
    return call_handler([&] {
        // Reserves one slot for all scans. The call cannot be rejected after some scans.
        QueueSlot slot = reserve_slot(queue_);
        const std::vector<RenderRequest> render_requests = reader_.read_rig(*request);
        std::span<const RenderRequest> remaining = render_requests;
        while (!remaining.empty()) {
            // Selects the next scans: all before the next image, or this image alone.
            const auto first_image = std::ranges::find_if(remaining, has_range_image);
            const auto n_before_image = std::size_t(first_image - remaining.begin());
            const std::size_t n_scans = std::clamp<std::size_t>(n_before_image, 1, kMostAtOnce);
            const std::size_t first_sensor = render_requests.size() - remaining.size();

            std::vector<v1::RigScan> scans(n_scans);
            std::vector<v1::LidarScan*> answers;
            for (v1::RigScan& scan : scans) answers.push_back(scan.mutable_scan());
            if (n_before_image > 0) render_points(slot, remaining.first(n_scans), *context, answers);
            else render_scan(slot, remaining.front(), *context, *answers.front());
            for (std::size_t i = 0; i < n_scans; ++i) {
                scans[i].set_name(request->sensors(int(first_sensor + i)).name());
                if (!writer->Write(scans[i])) fail_cancelled(*context);
            }
            remaining = remaining.subspan(n_scans);
        }
    });
}

}  // namespace relidar::serve
