// SPDX-License-Identifier: Apache-2.0
// Implements the gRPC calls of sensorsim.proto.
#pragma once

#include <grpcpp/server_builder.h>

#include "render_queue.hpp"
#include "sensorsim/sensorsim.pb.h"
#include "server.hpp"

namespace relidar::serve {

using grpc::ServerContext;
namespace sensorsim = nre::grpc::protos::sensorsim;
class RequestReader;
class SceneSet;
class SensorsimReader;
struct RenderRequest;

/// The service has one name per version of its protobuf package, for old and new clients.
class SensorsimService {
public:
    /// The queue and the scenes must outlive this object.
    /// @param scenes used only on the render thread
    SensorsimService(RenderQueue& queue, SceneSet& scenes, PoseTransformOrder order);
    ~SensorsimService();

    void register_in(grpc::ServerBuilder& builder);
    /// For example "nre.grpc.protos.sensorsim.SensorsimService".
    static std::vector<std::string> full_names();

private:
    class NamedService;

    RenderQueue& queue_;
    SceneSet& scenes_;
    const PoseTransformOrder order_;
    const std::unique_ptr<RequestReader> scene_reader_;
    const std::unique_ptr<SensorsimReader> reader_;
    std::vector<std::unique_ptr<NamedService>> named_;

    void get_version(sensorsim::VersionId& answer) const;
    void get_available_scenes(sensorsim::AvailableScenes& answer) const;
    void get_loaded_scenes(sensorsim::LoadedScenes& answer);
    void get_dynamic_objects(const sensorsim::SceneRequest& request, sensorsim::DynamicObjectTracks& answer);
    void get_available_trajectories(const sensorsim::SceneRequest& request,
                                    sensorsim::AvailableTrajectories& answer);
    void render_lidar(const ServerContext& context, const sensorsim::LidarRenderRequest& request,
                      sensorsim::LidarRenderReturn& answer);
    void render_aggregated(const ServerContext& context, const sensorsim::AggregatedRenderRequest& request,
                           sensorsim::AggregatedRenderReturn& answer);
    void render_points(QueueSlot& slot, const RenderRequest& request, const ServerContext& context,
                       sensorsim::LidarRenderReturn& answer);
};

}  // namespace relidar::serve
