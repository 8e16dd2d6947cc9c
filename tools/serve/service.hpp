// SPDX-License-Identifier: Apache-2.0
// Implements the gRPC calls of render.proto. Only the render thread renders.
#pragma once

#include <functional>
#include <span>
#include <utility>

#include "refusal.hpp"
#include "relidar/v1/render.grpc.pb.h"
#include "render_queue.hpp"
#include "request_messages.hpp"
#include "scenes.hpp"
#include "server.hpp"

namespace relidar::serve {

class RenderService final : public v1::RenderService::Service {
public:
    /// The queue and the scenes must outlive this object.
    /// @param scenes used only on the render thread
    RenderService(RenderQueue& queue, SceneSet& scenes) : queue_(queue), scenes_(scenes), reader_(scenes) {}

    grpc::Status ListScenes(grpc::ServerContext* context, const v1::ListScenesRequest* request,
                            v1::ListScenesResponse* answer) override;
    grpc::Status GetTracks(grpc::ServerContext* context, const v1::GetTracksRequest* request,
                           v1::GetTracksResponse* answer) override;
    grpc::Status SpawnActors(grpc::ServerContext* context, const v1::SpawnActorsRequest* request,
                             v1::SpawnActorsResponse* answer) override;
    grpc::Status DespawnActors(grpc::ServerContext* context, const v1::DespawnActorsRequest* request,
                               v1::DespawnActorsResponse* answer) override;
    grpc::Status UploadSensor(grpc::ServerContext* context, const v1::UploadSensorRequest* request,
                              v1::UploadSensorResponse* answer) override;
    grpc::Status RenderLidar(grpc::ServerContext* context, const v1::RenderLidarRequest* request,
                             v1::LidarScan* answer) override;
    grpc::Status RenderRig(grpc::ServerContext* context, const v1::RenderRigRequest* request,
                           grpc::ServerWriter<v1::RigScan>* writer) override;

private:
    RenderQueue& queue_;
    SceneSet& scenes_;
    RequestReader reader_;

    void render_scan(RenderQueue::QueueSlot& slot, const RenderRequest& request,
                     const grpc::ServerContext& context, v1::LidarScan& answer);
    void render_points(RenderQueue::QueueSlot& slot, std::span<const RenderRequest> requests,
                       const grpc::ServerContext& context, std::span<v1::LidarScan* const> answers);
};

}  // namespace relidar::serve
