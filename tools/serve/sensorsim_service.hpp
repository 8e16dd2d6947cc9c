// SPDX-License-Identifier: Apache-2.0
// Implements the gRPC calls of sensorsim.proto.
#pragma once

#include <deque>

#include <grpcpp/impl/service_type.h>
#include <grpcpp/server_context.h>

#include "render_queue.hpp"
#include "sensorsim/sensorsim.pb.h"
#include "server.hpp"

namespace relidar {
struct Run;
}

namespace relidar::serve {

using grpc::ServerContext;
namespace sensorsim = nre::grpc::protos::sensorsim;
class RequestReader;
class SceneSet;
class SensorsimReader;
struct RenderRequest;

class SensorsimService final : public grpc::Service {
public:
    /// For old and new clients: NuRec uses the second name since version 26.10.
    static constexpr const char* kNames[] = {"nre.grpc.protos.sensorsim.SensorsimService",
                                             "nurec.grpc.protos.sensorsim.SensorsimService"};

    /// The queue and the scenes must outlive this object.
    /// @param name one of kNames; they share the message types, because the wire format
    /// has no names of messages
    /// @param scenes used only on the render thread
    SensorsimService(const std::string& name, RenderQueue& queue, SceneSet& scenes, PoseTransformOrder order);
    ~SensorsimService() override;

private:
    /// Computes the answer, or throws RejectedRequest.
    template <class Request, class Answer>
    using Call = void (SensorsimService::*)(const ServerContext&, const Request&, Answer&);

    RenderQueue& queue_;
    SceneSet& scenes_;
    const PoseTransformOrder order_;
    const std::unique_ptr<RequestReader> scene_reader_;
    const std::unique_ptr<SensorsimReader> reader_;
    // gRPC keeps pointers to the names, and a deque does not move its elements.
    std::deque<std::string> method_names_;

    template <class Request, class Answer>
    void add_call(const std::string& full_name, Call<Request, Answer> call);

    void get_version(const ServerContext&, const sensorsim::Empty&, sensorsim::VersionId& answer);
    void get_available_scenes(const ServerContext&, const sensorsim::Empty&,
                              sensorsim::AvailableScenes& answer);
    void get_loaded_scenes(const ServerContext&, const sensorsim::Empty&, sensorsim::LoadedScenes& answer);
    void get_dynamic_objects(const ServerContext&, const sensorsim::SceneRequest& request,
                             sensorsim::DynamicObjectTracks& answer);
    void get_available_trajectories(const ServerContext&, const sensorsim::SceneRequest& request,
                                    sensorsim::AvailableTrajectories& answer);
    void get_available_cameras(const ServerContext&, const sensorsim::SceneRequest& request,
                               sensorsim::AvailableCameras&);
    void get_available_ego_masks(const ServerContext&, const sensorsim::Empty&,
                                 sensorsim::AvailableEgoMasks&) {}
    void render_lidar(const ServerContext& context, const sensorsim::LidarRenderRequest& request,
                      sensorsim::LidarRenderReturn& answer);
    void render_rgb(const ServerContext&, const sensorsim::RgbRenderRequest&, sensorsim::RgbRenderReturn&);
    void render_aggregated(const ServerContext& context, const sensorsim::AggregatedRenderRequest& request,
                           sensorsim::AggregatedRenderReturn& answer);
    void render_points(QueueSlot& slot, const RenderRequest& request, const ServerContext& context,
                       sensorsim::LidarRenderReturn& answer);
    const Run& find_run(const sensorsim::SceneRequest& request) const;
};

}  // namespace relidar::serve
