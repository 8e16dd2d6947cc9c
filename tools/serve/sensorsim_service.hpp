// SPDX-License-Identifier: Apache-2.0
// Implements the gRPC calls of sensorsim.proto. The render thread renders their scans
// together with the scans of render.proto.
#pragma once

#include <memory>

#include "render_queue.hpp"
#include "sensorsim/sensorsim.grpc.pb.h"
#include "server.hpp"

namespace relidar::serve {

namespace sensorsim = nre::grpc::protos::sensorsim;
class RequestReader;
class SceneSet;
class SensorsimReader;
struct RenderRequest;

class SensorsimService final : public sensorsim::SensorsimService::Service {
public:
    /// Creates the service. The queue and the scenes must outlive this object.
    /// @param scenes used only on the render thread
    SensorsimService(RenderQueue& queue, SceneSet& scenes, PoseOrder order);
    ~SensorsimService() override;

    grpc::Status get_version(grpc::ServerContext* context, const sensorsim::Empty* request,
                             sensorsim::VersionId* answer) override;
    grpc::Status get_available_scenes(grpc::ServerContext* context, const sensorsim::Empty* request,
                                      sensorsim::AvailableScenes* answer) override;
    grpc::Status get_available_trajectories(grpc::ServerContext* context,
                                            const sensorsim::SceneRequest* request,
                                            sensorsim::AvailableTrajectories* answer) override;
    grpc::Status get_available_cameras(grpc::ServerContext* context, const sensorsim::SceneRequest* request,
                                       sensorsim::AvailableCameras* answer) override;
    grpc::Status get_available_ego_masks(grpc::ServerContext* context, const sensorsim::Empty* request,
                                         sensorsim::AvailableEgoMasks* answer) override;
    grpc::Status render_lidar(grpc::ServerContext* context, const sensorsim::LidarRenderRequest* request,
                              sensorsim::LidarRenderReturn* answer) override;
    grpc::Status render_rgb(grpc::ServerContext* context, const sensorsim::RgbRenderRequest* request,
                            sensorsim::RgbRenderReturn* answer) override;
    grpc::Status render_aggregated(grpc::ServerContext* context,
                                   const sensorsim::AggregatedRenderRequest* request,
                                   sensorsim::AggregatedRenderReturn* answer) override;

private:
    RenderQueue& queue_;
    SceneSet& scenes_;
    const PoseOrder order_;
    const std::unique_ptr<RequestReader> scene_reader_;
    const std::unique_ptr<SensorsimReader> reader_;

    void render(RenderQueue::Slot& slot, const RenderRequest& wanted, const grpc::ServerContext& context,
                sensorsim::LidarRenderReturn& answer);
};

}  // namespace relidar::serve
