// SPDX-License-Identifier: Apache-2.0
#include "service.hpp"

#include <algorithm>

#include "answer_messages.hpp"
#include "asset_catalogue.hpp"
#include "render_requests.hpp"
#include "sensor_messages.hpp"

namespace relidar::serve {
namespace {

bool is_range_image_requested(const RenderRequest& request) {
    return request.range_image || request.drop_probability || request.boxes || !request.points;
}

void write_queue_and_render_time(const QueuedRequest& request, v1::LidarScan& answer) {
    answer.set_queued_ms(request.get_queued_time_ms());
    answer.set_rendered_ms(request.get_render_time_ms());
}

}  // namespace

void RenderService::render_scan_into_answer(RenderQueue::QueueSlot& queue_slot,
                                            const RenderRequest& render_request,
                                            const grpc::ServerContext& context, v1::LidarScan& answer) {
    ScanImageRequest request(scenes_, context, render_request);
    request.run_request_or_throw_if_cancelled(queue_slot);
    const TrainedRun& run = scenes_.get_runs_without_surfels()[render_request.scene];
    write_scan_into_message(request.scan, render_request, run.config, answer);
    if (render_request.boxes) write_actor_boxes_into_message(request.scan, render_request, run, answer);
    write_actors_with_too_few_surfels(render_request, answer);
    write_queue_and_render_time(request, answer);
}

void RenderService::render_points_into_answers(RenderQueue::QueueSlot& queue_slot,
                                               std::span<const RenderRequest> requests,
                                               const grpc::ServerContext& context,
                                               std::span<v1::LidarScan* const> answers) {
    PointsRequest request(scenes_, context, requests);
    request.run_request_or_throw_if_cancelled(queue_slot);
    for (std::size_t i = 0; i < requests.size(); ++i) {
        write_scan_into_message(request.points[i], requests[i], *answers[i]);
        write_actors_with_too_few_surfels(requests[i], *answers[i]);
        write_queue_and_render_time(request, *answers[i]);
    }
}

grpc::Status RenderService::ListScenes(grpc::ServerContext*, const v1::ListScenesRequest*,
                                       v1::ListScenesResponse* answer) {
    return call_and_convert_errors_to_status([&] {
        for (std::size_t i = 0; i < scenes_.get_runs_without_surfels().size(); ++i)
            write_scene_description(scenes_.get_scene_sources()[i].name,
                                    scenes_.get_runs_without_surfels()[i], *answer->add_scenes());
        for (std::size_t i = 0; i < scenes_.get_runs_without_surfels().size(); ++i)
            for (const SpawnedActorRegistry::SpawnSlot& spawn_slot :
                 scenes_.get_spawned_actors().list_occupied_slots(i))
                write_spawned_actor(spawn_slot, scenes_.get_runs_without_surfels()[i],
                                    *answer->mutable_scenes(int(i))->add_spawned());
        for (const AssetCatalogue::CatalogueEntry& entry : scenes_.get_asset_catalogue().get_entries())
            write_asset_into_message(entry.facts, *answer->add_assets());
        for (const std::string& name : list_sensor_names()) answer->add_sensors(name);
    });
}

grpc::Status RenderService::GetTracks(grpc::ServerContext*, const v1::GetTracksRequest* request,
                                      v1::GetTracksResponse* answer) {
    return call_and_convert_errors_to_status([&] {
        const std::size_t scene = reader_.find_scene_index_or_throw(request->scene());
        const int lidar = reader_.find_lidar_index_or_throw(scene, request->lidar());
        write_recorded_tracks(scenes_.get_runs_without_surfels()[scene], lidar, request->actors(), *answer);
    });
}

grpc::Status RenderService::SpawnActors(grpc::ServerContext* context, const v1::SpawnActorsRequest* request,
                                        v1::SpawnActorsResponse* answer) {
    return call_and_convert_errors_to_status([&] {
        RenderQueue::QueueSlot slot = reserve_slot_or_throw(queue_);
        const std::size_t scene = reader_.find_scene_index_or_throw(request->scene());
        const std::vector<ActorToSpawn> wishes = reader_.read_actors_to_spawn(*request, scene);
        SpawnRequest spawn(scenes_, *context, scene, wishes);
        spawn.run_request_or_throw_if_cancelled(slot);
        for (const SpawnedActorRegistry::SpawnSlot& spawn_slot : spawn.occupied_slots)
            write_spawned_actor(spawn_slot, scenes_.get_runs_without_surfels()[scene], *answer->add_actors());
    });
}

grpc::Status RenderService::DespawnActors(grpc::ServerContext*, const v1::DespawnActorsRequest* request,
                                          v1::DespawnActorsResponse* answer) {
    return call_and_convert_errors_to_status([&] {
        const std::size_t scene = reader_.find_scene_index_or_throw(request->scene());
        scenes_.get_spawned_actors().remove_actors_and_free_slots(
            scene, {request->names().begin(), request->names().end()});
        answer->set_left(std::uint32_t(scenes_.get_spawned_actors().list_occupied_slots(scene).size()));
    });
}

grpc::Status RenderService::UploadSensor(grpc::ServerContext*, const v1::UploadSensorRequest* request,
                                         v1::UploadSensorResponse* answer) {
    return call_and_convert_errors_to_status([&] {
        const auto [handle, sensor] = reader_.cache_uploaded_sensor(request->sensor());
        const FiringTimeSpan span = compute_firing_span(*sensor);
        answer->set_handle(handle);
        answer->set_rays(count_rays_of_sensor(*sensor));
        answer->set_first_ray_s(span.first_s);
        answer->set_last_ray_s(span.last_s);
        answer->set_kept(std::uint32_t(SensorCache::kMostSensors));
    });
}

grpc::Status RenderService::RenderLidar(grpc::ServerContext* context, const v1::RenderLidarRequest* request,
                                        v1::LidarScan* answer) {
    return call_and_convert_errors_to_status([&] {
        RenderQueue::QueueSlot slot = reserve_slot_or_throw(queue_);
        const RenderRequest render_request = reader_.convert_to_checked_render_request(*request);
        if (!is_range_image_requested(render_request))
            return render_points_into_answers(slot, {&render_request, 1}, *context, {&answer, 1});
        render_scan_into_answer(slot, render_request, *context, *answer);
    });
}

grpc::Status RenderService::RenderRig(grpc::ServerContext* context, const v1::RenderRigRequest* request,
                                      grpc::ServerWriter<v1::RigScan>* writer) {
    return call_and_convert_errors_to_status([&] {
        // Reserves one slot for all scans of the rig, so that the call is not rejected
        // after some scans.
        RenderQueue::QueueSlot slot = reserve_slot_or_throw(queue_);
        const std::vector<RenderRequest> render_requests =
            reader_.convert_to_request_per_rig_sensor(*request);
        for (std::size_t first = 0, n = 1; first < render_requests.size(); first += n) {
            for (n = 0; n < kMostAtOnce && first + n < render_requests.size() &&
                        !is_range_image_requested(render_requests[first + n]);)
                ++n;
            const bool of_points = n > 0;
            n = std::max<std::size_t>(n, 1);
            std::vector<v1::RigScan> scans(n);
            std::vector<v1::LidarScan*> answers;
            for (v1::RigScan& scan : scans) answers.push_back(scan.mutable_scan());
            if (of_points)
                render_points_into_answers(slot, std::span(render_requests).subspan(first, n), *context,
                                           answers);
            else render_scan_into_answer(slot, render_requests[first], *context, *answers.front());
            for (std::size_t i = 0; i < n; ++i) {
                scans[i].set_name(request->sensors(int(first + i)).name());
                if (!writer->Write(scans[i])) throw_deadline_or_cancelled_error(*context);
            }
        }
    });
}

}  // namespace relidar::serve
