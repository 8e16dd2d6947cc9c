// SPDX-License-Identifier: Apache-2.0
#include "service.hpp"

#include <algorithm>

#include "answer_messages.hpp"
#include "asset_catalogue.hpp"
#include "render_requests.hpp"
#include "sensor_messages.hpp"
#include "spawn_messages.hpp"

namespace relidar::serve {
namespace {

bool needs_image(const RenderRequest& request) {
    return request.range_image || request.drop_probability || request.boxes || !request.points;
}

void write_times(const Request& request, v1::LidarScan& answer) {
    answer.set_queued_ms(request.queued_ms());
    answer.set_rendered_ms(request.rendered_ms());
}

}  // namespace

RenderedScan RenderService::render_image(RenderQueue::Slot& slot, const RenderRequest& render_request,
                                         const grpc::ServerContext& context, v1::LidarScan& answer) {
    ScanImageRequest request(scenes_, context, render_request);
    request.run(slot);
    const Run& run = scenes_.outlines()[render_request.scene];
    write_scan(request.scan, render_request, run.config, answer);
    if (render_request.boxes) write_boxes(request.scan, render_request, run, answer);
    write_sparse_actors(render_request, answer);
    write_times(request, answer);
    return std::move(request.scan);
}

void RenderService::render_points(RenderQueue::Slot& slot, std::span<const RenderRequest> requests,
                                  const grpc::ServerContext& context,
                                  std::span<v1::LidarScan* const> answers) {
    PointsRequest request(scenes_, context, requests);
    request.run(slot);
    for (std::size_t i = 0; i < requests.size(); ++i) {
        write_scan(request.points[i], requests[i], *answers[i]);
        write_sparse_actors(requests[i], *answers[i]);
        write_times(request, *answers[i]);
    }
}

grpc::Status RenderService::ListScenes(grpc::ServerContext*, const v1::ListScenesRequest*,
                                       v1::ListScenesResponse* answer) {
    return run_with_grpc_status([&] {
        for (std::size_t i = 0; i < scenes_.outlines().size(); ++i)
            write_scene(scenes_.sources()[i].name, scenes_.outlines()[i], *answer->add_scenes());
        for (std::size_t i = 0; i < scenes_.outlines().size(); ++i)
            for (const SpawnedActors::Place& place : scenes_.spawned().list_occupied_slots(i))
                write_spawned(place, scenes_.outlines()[i], *answer->mutable_scenes(int(i))->add_spawned());
        for (const AssetCatalogue::Entry& entry : scenes_.assets().entries())
            write_asset(entry.facts, *answer->add_assets());
        for (const std::string& name : list_sensor_names()) answer->add_sensors(name);
    });
}

grpc::Status RenderService::GetTracks(grpc::ServerContext*, const v1::GetTracksRequest* request,
                                      v1::GetTracksResponse* answer) {
    return run_with_grpc_status([&] {
        const std::size_t scene = reader_.find_scene(request->scene());
        const int lidar = reader_.find_lidar(scene, request->lidar());
        write_tracks(scenes_.outlines()[scene], lidar, request->actors(), *answer);
    });
}

grpc::Status RenderService::SpawnActors(grpc::ServerContext* context, const v1::SpawnActorsRequest* request,
                                        v1::SpawnActorsResponse* answer) {
    return run_with_grpc_status([&] {
        RenderQueue::Slot slot = reserve(queue_);
        const std::size_t scene = reader_.find_scene(request->scene());
        const std::vector<ActorToSpawn> wishes = reader_.read_spawns(*request, scene);
        SpawnRequest spawn(scenes_, *context, scene, wishes);
        spawn.run(slot);
        for (const SpawnedActors::Place& place : spawn.places)
            write_spawned(place, scenes_.outlines()[scene], *answer->add_actors());
    });
}

grpc::Status RenderService::DespawnActors(grpc::ServerContext*, const v1::DespawnActorsRequest* request,
                                          v1::DespawnActorsResponse* answer) {
    return run_with_grpc_status([&] {
        const std::size_t scene = reader_.find_scene(request->scene());
        scenes_.spawned().release(scene, {request->names().begin(), request->names().end()});
        answer->set_left(std::uint32_t(scenes_.spawned().list_occupied_slots(scene).size()));
    });
}

grpc::Status RenderService::UploadSensor(grpc::ServerContext*, const v1::UploadSensorRequest* request,
                                         v1::UploadSensorResponse* answer) {
    return run_with_grpc_status([&] {
        const auto [handle, sensor] = reader_.upload(request->sensor());
        const FiringSpan span = compute_firing_span(*sensor);
        answer->set_handle(handle);
        answer->set_rays(count_rays(*sensor));
        answer->set_first_ray_s(span.first_s);
        answer->set_last_ray_s(span.last_s);
        answer->set_kept(std::uint32_t(SensorCache::kMostSensors));
    });
}

grpc::Status RenderService::RenderLidar(grpc::ServerContext* context, const v1::RenderLidarRequest* request,
                                        v1::LidarScan* answer) {
    return run_with_grpc_status([&] {
        RenderQueue::Slot slot = reserve(queue_);
        const RenderRequest wanted = reader_.read(*request);
        if (!on_scan_ && !needs_image(wanted))
            return render_points(slot, {&wanted, 1}, *context, {&answer, 1});
        const RenderedScan scan = render_image(slot, wanted, *context, *answer);
        if (on_scan_)
            on_scan_(scenes_.outlines()[wanted.scene], *wanted.sensor, request->sensor().name(), scan);
    });
}

grpc::Status RenderService::RenderRig(grpc::ServerContext* context, const v1::RenderRigRequest* request,
                                      grpc::ServerWriter<v1::RigScan>* writer) {
    return run_with_grpc_status([&] {
        if (on_scan_)
            throw Refusal(grpc::StatusCode::FAILED_PRECONDITION,
                          "RenderRig: the server sends packets (--udp), expected RenderLidar calls, because "
                          "a receiver expects the packets of a single sensor");
        // Reserves one slot for all scans of the rig, so that the call is not rejected
        // after some scans.
        RenderQueue::Slot slot = reserve(queue_);
        const std::vector<RenderRequest> wanted = reader_.read(*request);
        for (std::size_t first = 0, n = 1; first < wanted.size(); first += n) {
            for (n = 0; n < kMostAtOnce && first + n < wanted.size() && !needs_image(wanted[first + n]);) ++n;
            const bool of_points = n > 0;
            n = std::max<std::size_t>(n, 1);
            std::vector<v1::RigScan> scans(n);
            std::vector<v1::LidarScan*> answers;
            for (v1::RigScan& scan : scans) answers.push_back(scan.mutable_scan());
            if (of_points) render_points(slot, std::span(wanted).subspan(first, n), *context, answers);
            else render_image(slot, wanted[first], *context, *answers.front());
            for (std::size_t i = 0; i < n; ++i) {
                scans[i].set_name(request->sensors(int(first + i)).name());
                if (!writer->Write(scans[i])) throw_if_cancelled(*context);
            }
        }
    });
}

}  // namespace relidar::serve
