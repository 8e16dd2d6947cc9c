// SPDX-License-Identifier: Apache-2.0
#include "sensorsim_service.hpp"

#include <fmt/format.h>

#include "refusal.hpp"
#include "render_requests.hpp"
#include "scenes.hpp"
#include "sensorsim_messages.hpp"

namespace relidar::serve {
namespace {

// Maximum number of scans per call. The maximum number of sensors of a rig is the same.
constexpr int kMostScans = 64;

[[noreturn]] void refuse_images(const std::string& call, const std::string& found) {
    throw Refusal(
        grpc::StatusCode::UNIMPLEMENTED,
        fmt::format("cannot answer {}: found {}, expected only LiDAR scans (render_lidar), because relidar "
                    "renders no camera images",
                    call, found));
}

}  // namespace

SensorsimService::SensorsimService(RenderQueue& queue, SceneSet& scenes, PoseOrder order)
    : queue_(queue),
      scenes_(scenes),
      order_(order),
      scene_reader_(std::make_unique<RequestReader>(scenes)),
      reader_(std::make_unique<SensorsimReader>(scenes.outlines(), *scene_reader_, order)) {}

SensorsimService::~SensorsimService() = default;

grpc::Status SensorsimService::get_version(grpc::ServerContext*, const sensorsim::Empty*,
                                           sensorsim::VersionId* answer) {
    answer->set_version("relidar " RELIDAR_VERSION);
    answer->mutable_numbers()->set_major(RELIDAR_VERSION_MAJOR);
    answer->mutable_numbers()->set_minor(RELIDAR_VERSION_MINOR);
    answer->mutable_numbers()->set_patch(RELIDAR_VERSION_PATCH);
    return grpc::Status::OK;
}

grpc::Status SensorsimService::get_available_scenes(grpc::ServerContext*, const sensorsim::Empty*,
                                                    sensorsim::AvailableScenes* answer) {
    for (const SceneSource& source : scenes_.sources()) answer->add_scene_ids(source.name);
    return grpc::Status::OK;
}

grpc::Status SensorsimService::get_available_trajectories(grpc::ServerContext*,
                                                          const sensorsim::SceneRequest* request,
                                                          sensorsim::AvailableTrajectories* answer) {
    return answered([&] {
        write_trajectories(scenes_.outlines()[reader_->find_scene(request->scene_id())], order_, *answer);
    });
}

grpc::Status SensorsimService::get_available_cameras(grpc::ServerContext*,
                                                     const sensorsim::SceneRequest* request,
                                                     sensorsim::AvailableCameras*) {
    return answered([&] { reader_->find_scene(request->scene_id()); });
}

grpc::Status SensorsimService::get_available_ego_masks(grpc::ServerContext*, const sensorsim::Empty*,
                                                       sensorsim::AvailableEgoMasks*) {
    return grpc::Status::OK;
}

void SensorsimService::render(RenderQueue::Slot& slot, const RenderRequest& wanted,
                              const grpc::ServerContext& context, sensorsim::LidarRenderReturn& answer) {
    PointsRequest request(scenes_, context, {&wanted, 1});
    request.run(slot);
    write_points(request.points.front().points, answer);
}

grpc::Status SensorsimService::render_lidar(grpc::ServerContext* context,
                                            const sensorsim::LidarRenderRequest* request,
                                            sensorsim::LidarRenderReturn* answer) {
    return answered([&] {
        RenderQueue::Slot slot = reserve(queue_);
        render(slot, reader_->read(*request), *context, *answer);
    });
}

grpc::Status SensorsimService::render_rgb(grpc::ServerContext*, const sensorsim::RgbRenderRequest*,
                                          sensorsim::RgbRenderReturn*) {
    return answered([] { refuse_images("render_rgb", "a request for an image"); });
}

grpc::Status SensorsimService::render_aggregated(grpc::ServerContext* context,
                                                 const sensorsim::AggregatedRenderRequest* request,
                                                 sensorsim::AggregatedRenderReturn* answer) {
    return answered([&] {
        if (request->rgb_size() > 0)
            refuse_images("render_aggregated", fmt::format("a request for {} images", request->rgb_size()));
        if (request->lidar_size() > kMostScans)
            refuse("lidar", fmt::format("{} scans", request->lidar_size()),
                   fmt::format("at most {} per call", kMostScans));
        // Reserves one slot for all scans of the call, so that the call is not rejected
        // after some scans.
        RenderQueue::Slot slot = reserve(queue_);
        std::vector<RenderRequest> wanted;
        for (const sensorsim::LidarRenderRequest& lidar : request->lidar())
            wanted.push_back(reader_->read(lidar));
        for (const RenderRequest& scan : wanted) render(slot, scan, *context, *answer->add_lidar());
    });
}

}  // namespace relidar::serve
