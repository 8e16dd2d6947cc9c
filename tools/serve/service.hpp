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

    Status ListScenes(ServerContext*, const v1::ListScenesRequest*, v1::ListScenesResponse*) override;
    Status GetTracks(ServerContext*, const v1::GetTracksRequest*, v1::GetTracksResponse*) override;
    Status SpawnActors(ServerContext*, const v1::SpawnActorsRequest*, v1::SpawnActorsResponse*) override;
    Status DespawnActors(ServerContext*, const v1::DespawnActorsRequest*,
                         v1::DespawnActorsResponse*) override;
    Status UploadSensor(ServerContext*, const v1::UploadSensorRequest*, v1::UploadSensorResponse*) override;
    Status RenderLidar(ServerContext*, const v1::RenderLidarRequest*, v1::LidarScan*) override;
    Status RenderRig(ServerContext*, const v1::RenderRigRequest*, grpc::ServerWriter<v1::RigScan>*) override;

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
