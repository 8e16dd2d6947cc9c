// SPDX-License-Identifier: Apache-2.0
// Implements the gRPC calls of render.proto. Only the render thread renders.
#pragma once

#include "refusal.hpp"
#include "relidar/v1/render.grpc.pb.h"
#include "render_queue.hpp"
#include "request_messages.hpp"
#include "scenes.hpp"
#include "server.hpp"

namespace relidar::serve {

using grpc::ServerContext, grpc::Status;

class RenderService final : public v1::RenderService::Service {
public:
    /// The queue and the scenes must outlive this object.
    /// @param scenes used only on the render thread
    RenderService(RenderQueue& queue, SceneSet& scenes) : queue_(queue), scenes_(scenes), reader_(scenes) {}

    Status ListScenes(ServerContext*, const v1::ListScenesRequest* request,
                      v1::ListScenesResponse* answer) override;
    Status GetTracks(ServerContext*, const v1::GetTracksRequest* request,
                     v1::GetTracksResponse* answer) override;
    Status SpawnActors(ServerContext*, const v1::SpawnActorsRequest* request,
                       v1::SpawnActorsResponse* answer) override;
    Status DespawnActors(ServerContext*, const v1::DespawnActorsRequest* request,
                         v1::DespawnActorsResponse* answer) override;
    Status UploadSensor(ServerContext*, const v1::UploadSensorRequest* request,
                        v1::UploadSensorResponse* answer) override;
    Status RenderLidar(ServerContext*, const v1::RenderLidarRequest* request, v1::LidarScan* answer) override;
    Status RenderRig(ServerContext*, const v1::RenderRigRequest* request,
                     grpc::ServerWriter<v1::RigScan>* writer) override;

private:
    RenderQueue& queue_;
    SceneSet& scenes_;
    RequestReader reader_;

    void render_scan(QueueSlot& slot, const RenderRequest& request, const ServerContext& context,
                     v1::LidarScan& answer);
    void render_points(QueueSlot& slot, std::span<const RenderRequest> requests, const ServerContext& context,
                       std::span<v1::LidarScan* const> answers);
};

}  // namespace relidar::serve
