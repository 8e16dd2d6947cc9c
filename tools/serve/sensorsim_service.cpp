// SPDX-License-Identifier: Apache-2.0
#include "sensorsim_service.hpp"

#include <grpcpp/impl/rpc_service_method.h>
#include <grpcpp/impl/service_type.h>
#include <grpcpp/support/method_handler.h>

#include "refusal.hpp"
#include "render_requests.hpp"
#include "scenes.hpp"
#include "sensorsim_messages.hpp"

namespace relidar::serve {
namespace {

constexpr int kMostScans = 64;

[[noreturn]] void reject_camera(const std::string& rpc_name, const std::string& found) {
    refuse(Code::UNIMPLEMENTED, "cannot answer {}: found {}, expected LiDAR scans only (render_lidar)",
           rpc_name, found);
}

// NuRec uses the second name since version 26.10.
constexpr const char* kPackageNames[] = {"nre.grpc.protos", "nurec.grpc.protos"};

}  // namespace

/// All names share the message types, because the wire format has no names of messages.
class SensorsimService::NamedService final : public grpc::Service {
public:
    NamedService(SensorsimService& calls, const std::string& full_name) : path_("/" + full_name + "/") {
        using Context = const ServerContext&;
        register_method<sensorsim::Empty, sensorsim::VersionId>(
            "get_version", [&](Context, const auto&, auto& answer) { calls.get_version(answer); });
        register_method<sensorsim::Empty, sensorsim::AvailableScenes>(
            "get_available_scenes",
            [&](Context, const auto&, auto& answer) { calls.get_available_scenes(answer); });
        register_method<sensorsim::Empty, sensorsim::LoadedScenes>(
            "get_loaded_scenes",
            [&](Context, const auto&, auto& answer) { calls.get_loaded_scenes(answer); });
        register_method<sensorsim::SceneRequest, sensorsim::DynamicObjectTracks>(
            "get_dynamic_objects",
            [&](Context, const auto& request, auto& answer) { calls.get_dynamic_objects(request, answer); });
        register_method<sensorsim::SceneRequest, sensorsim::AvailableTrajectories>(
            "get_available_trajectories", [&](Context, const auto& request, auto& answer) {
                calls.get_available_trajectories(request, answer);
            });
        // relidar has no cameras, so this answer and the next one stay empty.
        register_method<sensorsim::SceneRequest, sensorsim::AvailableCameras>(
            "get_available_cameras",
            [&](Context, const auto& request, auto&) { calls.reader_->find_scene(request.scene_id()); });
        register_method<sensorsim::Empty, sensorsim::AvailableEgoMasks>("get_available_ego_masks",
                                                                        [](Context, const auto&, auto&) {});
        register_method<sensorsim::LidarRenderRequest, sensorsim::LidarRenderReturn>(
            "render_lidar", [&](Context context, const auto& request, auto& answer) {
                calls.render_lidar(context, request, answer);
            });
        register_method<sensorsim::RgbRenderRequest, sensorsim::RgbRenderReturn>(
            "render_rgb",
            [](Context, const auto&, auto&) { reject_camera("render_rgb", "a request for an image"); });
        register_method<sensorsim::AggregatedRenderRequest, sensorsim::AggregatedRenderReturn>(
            "render_aggregated", [&](Context context, const auto& request, auto& answer) {
                calls.render_aggregated(context, request, answer);
            });
    }

private:
    const std::string path_;
    // gRPC keeps pointers to the names, and a deque does not move its elements.
    std::deque<std::string> methods_;

    /// Registers an RPC method with gRPC.
    /// @param handle_call computes the answer, or throws RejectedRequest
    template <class RequestMessage, class Answer, class Function>
    void register_method(const std::string& method_name, Function handle_call) {
        using grpc::internal::RpcMethodHandler, grpc::internal::RpcServiceMethod;
        const auto call = [handle_call](NamedService*, ServerContext* context, const RequestMessage* request,
                                        Answer* answer) {
            return call_handler([&] { handle_call(*context, *request, *answer); });
        };
        AddMethod(new RpcServiceMethod(
            methods_.emplace_back(path_ + method_name).c_str(), grpc::internal::RpcMethod::NORMAL_RPC,
            new RpcMethodHandler<NamedService, RequestMessage, Answer>(call, this)));
    }
};

SensorsimService::SensorsimService(RenderQueue& queue, SceneSet& scenes, PoseTransformOrder order)
    : queue_(queue),
      scenes_(scenes),
      order_(order),
      scene_reader_(std::make_unique<RequestReader>(scenes)),
      reader_(std::make_unique<SensorsimReader>(scenes.runs(), *scene_reader_, order)) {
    for (const std::string& name : full_names())
        named_.push_back(std::make_unique<NamedService>(*this, name));
}

SensorsimService::~SensorsimService() = default;

std::vector<std::string> SensorsimService::full_names() {
    std::vector<std::string> names;
    for (const std::string package : kPackageNames) names.push_back(package + ".sensorsim.SensorsimService");
    return names;
}

void SensorsimService::register_in(grpc::ServerBuilder& builder) {
    for (const std::unique_ptr<NamedService>& service : named_) builder.RegisterService(service.get());
}

void SensorsimService::get_version(sensorsim::VersionId& answer) const {
    answer.set_version("relidar " RELIDAR_VERSION);
    answer.mutable_numbers()->set_major(RELIDAR_VERSION_MAJOR);
    answer.mutable_numbers()->set_minor(RELIDAR_VERSION_MINOR);
    answer.mutable_numbers()->set_patch(RELIDAR_VERSION_PATCH);
}

void SensorsimService::get_available_scenes(sensorsim::AvailableScenes& answer) const {
    for (const SceneSource& source : scenes_.sources()) answer.add_scene_ids(source.name);
}

void SensorsimService::get_loaded_scenes(sensorsim::LoadedScenes& answer) {
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

void SensorsimService::get_dynamic_objects(const sensorsim::SceneRequest& request,
                                           sensorsim::DynamicObjectTracks& answer) {
    write_actors(scenes_.runs()[reader_->find_scene(request.scene_id())], order_, answer);
}

void SensorsimService::get_available_trajectories(const sensorsim::SceneRequest& request,
                                                  sensorsim::AvailableTrajectories& answer) {
    write_paths(scenes_.runs()[reader_->find_scene(request.scene_id())], order_, answer);
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
