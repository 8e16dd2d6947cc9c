// SPDX-License-Identifier: Apache-2.0
#include "sensorsim_service.hpp"

#include <grpcpp/impl/codegen/proto_utils.h>  // how messages are serialised
#include <grpcpp/impl/rpc_service_method.h>
#include <grpcpp/support/method_handler.h>

#include "refusal.hpp"
#include "render_requests.hpp"
#include "sensorsim_messages.hpp"

namespace relidar::serve {
namespace {

constexpr int kMostScans = 64;

[[noreturn]] void reject_camera(const std::string& rpc_name, const std::string& found) {
    refuse(Code::UNIMPLEMENTED, "cannot answer {}: found {}, expected LiDAR scans only (render_lidar)",
           rpc_name, found);
}

}  // namespace

/// Registers all methods under the given name of the service.
SensorsimService::SensorsimService(const std::string& name, RenderQueue& queue, SceneSet& scenes,
                                   PoseTransformOrder order)
    : queue_(queue),
      scenes_(scenes),
      order_(order),
      scene_reader_(std::make_unique<RequestReader>(scenes)),
      reader_(std::make_unique<SensorsimReader>(scenes.runs(), *scene_reader_, order)) {
    const std::string path = "/" + name + "/";
    add_call(path + "get_version", &SensorsimService::get_version);
    add_call(path + "get_available_scenes", &SensorsimService::get_available_scenes);
    add_call(path + "get_loaded_scenes", &SensorsimService::get_loaded_scenes);
    add_call(path + "get_dynamic_objects", &SensorsimService::get_dynamic_objects);
    add_call(path + "get_available_trajectories", &SensorsimService::get_available_trajectories);
    add_call(path + "get_available_cameras", &SensorsimService::get_available_cameras);
    add_call(path + "get_available_ego_masks", &SensorsimService::get_available_ego_masks);
    add_call(path + "render_lidar", &SensorsimService::render_lidar);
    add_call(path + "render_rgb", &SensorsimService::render_rgb);
    add_call(path + "render_aggregated", &SensorsimService::render_aggregated);
}

SensorsimService::~SensorsimService() = default;

/// Registers a method with gRPC at run time, because the generated service class has only
/// one service name, and this service has two (kNames).
template <class Request, class Answer>
void SensorsimService::add_call(const std::string& full_name, Call<Request, Answer> call) {
    using grpc::internal::RpcMethodHandler, grpc::internal::RpcServiceMethod;
    const auto handle = [call](SensorsimService* self, ServerContext* context, const Request* request,
                               Answer* answer) {
        return call_handler([&] { (self->*call)(*context, *request, *answer); });
    };
    AddMethod(new RpcServiceMethod(method_names_.emplace_back(full_name).c_str(),
                                   grpc::internal::RpcMethod::NORMAL_RPC,
                                   new RpcMethodHandler<SensorsimService, Request, Answer>(handle, this)));
}

const Run& SensorsimService::find_run(const sensorsim::SceneRequest& request) const {
    return scenes_.runs()[reader_->find_scene(request.scene_id())];
}

void SensorsimService::get_version(const ServerContext&, const sensorsim::Empty&,
                                   sensorsim::VersionId& answer) {
    answer.set_version("relidar " RELIDAR_VERSION);
    answer.mutable_numbers()->set_major(RELIDAR_VERSION_MAJOR);
    answer.mutable_numbers()->set_minor(RELIDAR_VERSION_MINOR);
    answer.mutable_numbers()->set_patch(RELIDAR_VERSION_PATCH);
}

void SensorsimService::get_available_scenes(const ServerContext&, const sensorsim::Empty&,
                                            sensorsim::AvailableScenes& answer) {
    for (const SceneSource& source : scenes_.sources()) answer.add_scene_ids(source.name);
}

/// Lists the scenes that are on the device now. An instance is a loaded copy of a scene;
/// relidar loads at most one copy, which all calls share.
void SensorsimService::get_loaded_scenes(const ServerContext&, const sensorsim::Empty&,
                                         sensorsim::LoadedScenes& answer) {
    // Only the render thread may use the scenes, so the queue runs this function.
    reserve_slot(queue_).run_function([&] {
        for (std::size_t i = 0; i < scenes_.sources().size(); ++i) {
            if (!scenes_.is_scene_on_gpu(i)) continue;
            sensorsim::LoadedScene& scene = *answer.add_scenes();
            scene.set_scene_id(scenes_.sources()[i].name);
            scene.set_loaded_instance_count(1);
            scene.set_reusable_instance_count(1);
        }
    });
    answer.set_loaded_instance_capacity(scenes_.sources().size());
}

void SensorsimService::get_dynamic_objects(const ServerContext&, const sensorsim::SceneRequest& request,
                                           sensorsim::DynamicObjectTracks& answer) {
    write_actors(find_run(request), order_, answer);
}

void SensorsimService::get_available_trajectories(const ServerContext&,
                                                  const sensorsim::SceneRequest& request,
                                                  sensorsim::AvailableTrajectories& answer) {
    write_paths(find_run(request), order_, answer);
}

/// relidar has no cameras, so the answer is empty.
void SensorsimService::get_available_cameras(const ServerContext&, const sensorsim::SceneRequest& request,
                                             sensorsim::AvailableCameras&) {
    (void)find_run(request);
}

void SensorsimService::render_rgb(const ServerContext&, const sensorsim::RgbRenderRequest&,
                                  sensorsim::RgbRenderReturn&) {
    reject_camera("render_rgb", "a request for an image");
}

void SensorsimService::render_points(QueueSlot& slot, const RenderRequest& render_request,
                                     const ServerContext& context, sensorsim::LidarRenderReturn& answer) {
    PointsRequest request(scenes_, context, {&render_request, 1});
    request.run_checked(slot);
    write_points(request.points.front().points, answer);
}

void SensorsimService::render_lidar(const ServerContext& context,
                                    const sensorsim::LidarRenderRequest& request,
                                    sensorsim::LidarRenderReturn& answer) {
    QueueSlot slot = reserve_slot(queue_);
    render_points(slot, reader_->read_request(request), context, answer);
}

/// Renders several scans in one call.
void SensorsimService::render_aggregated(const ServerContext& context,
                                         const sensorsim::AggregatedRenderRequest& request,
                                         sensorsim::AggregatedRenderReturn& answer) {
    if (request.rgb_size() > 0)
        reject_camera("render_aggregated", fmt::format("a request for {} images", request.rgb_size()));
    if (request.lidar_size() > kMostScans)
        reject_field("lidar", fmt::format("{} scans", request.lidar_size()),
                     fmt::format("at most {} per call", kMostScans));
    // One slot for all scans of the call, so that the call is not rejected in the middle.
    QueueSlot slot = reserve_slot(queue_);
    std::vector<RenderRequest> render_requests;
    for (const sensorsim::LidarRenderRequest& lidar : request.lidar())
        render_requests.push_back(reader_->read_request(lidar));
    for (const RenderRequest& scan : render_requests) render_points(slot, scan, context, *answer.add_lidar());
}

}  // namespace relidar::serve
