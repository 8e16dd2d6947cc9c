// SPDX-License-Identifier: Apache-2.0
#include "render_requests.hpp"

#include <chrono>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "refusal.hpp"

namespace relidar::serve {
namespace {

std::vector<std::string> list_names_of_spawned(const std::vector<SpawnedActors::Place>& places) {
    std::vector<std::string> names;
    for (const SpawnedActors::Place& place : places) names.push_back(place.actor.name);
    return names;
}

/// Calls a function with the renderer of the requested scene. If the scene cannot be
/// loaded, the error message names the folder of its run.
template <class Function>
SceneSet::Load use_requested_scene(SceneSet& scenes, const RenderRequest& request, const Function& function) {
    try {
        return scenes.use(request.scene, request.weather, [&](ScanRenderer& renderer) {
            renderer.enable_actor_views(request.boxes);
            function(renderer);
        });
    } catch (const DataError& error) {
        throw Refusal(grpc::StatusCode::INTERNAL, error.what());
    }
}

bool is_late(const grpc::ServerContext& context) {
    return std::chrono::system_clock::now() >= context.deadline();
}

}  // namespace

RenderQueue::Slot reserve(RenderQueue& queue) {
    std::optional<RenderQueue::Slot> slot = queue.reserve();
    if (!slot)
        throw Refusal(
            grpc::StatusCode::RESOURCE_EXHAUSTED,
            fmt::format("cannot queue the request: all {} slots of the queue are occupied; try again later",
                        queue.slots()));
    return std::move(*slot);
}

bool ClientRequest::is_cancelled() const { return context_.IsCancelled() || is_late(context_); }

void ClientRequest::run(RenderQueue::Slot& slot) {
    const bool is_done = slot.run(*this) == RenderQueue::Outcome::done;
    if (is_done && !is_cancelled()) return;
    if (is_done) undo();
    throw_if_cancelled(context_);
}

void throw_if_cancelled(const grpc::ServerContext& context) {
    if (is_late(context))
        throw Refusal(grpc::StatusCode::DEADLINE_EXCEEDED,
                      "cannot answer the request: its deadline has passed; set a later deadline");
    throw Refusal(grpc::StatusCode::CANCELLED, "cannot answer the request: the client has disconnected");
}

void ScanImageRequest::submit(bool) {
    use_requested_scene(scenes_, wanted_, [&](ScanRenderer& renderer) {
        scan = renderer.render(*wanted_.sensor, wanted_.request, wanted_.sample);
    });
}

PointsRequest::PointsRequest(SceneSet& scenes, const grpc::ServerContext& context,
                             std::span<const RenderRequest> requests)
    : ClientRequest(scenes, context), wanted_(requests) {
    scene = requests.front().scene;
}

void PointsRequest::submit(bool is_last) {
    using Send = ScanRenderer::Send;
    try {
        for (const RenderRequest& scan : wanted_) {
            const Send when = is_last && &scan == &wanted_.back() ? Send::now : Send::with_next;
            load_ = use_requested_scene(scenes_, scan, [&](ScanRenderer& renderer) {
                renderer.submit_points(*scan.sensor, scan.request, scan.points_at_s, scan.sample, when);
            });
            ++n_submitted_;
        }
    } catch (...) {
        if (n_submitted_ == 0) throw;
        submit_failure_ = std::current_exception();
    }
}

void PointsRequest::finish() {
    scenes_.call_with_loaded_scene(*scene, load_, [&](ScanRenderer& renderer) {
        while (points.size() < n_submitted_) points.push_back(renderer.wait_for_points());
    });
    if (submit_failure_) std::rethrow_exception(submit_failure_);
}

void SpawnRequest::submit(bool) { places = scenes_.spawn(spawn_scene_, wishes_); }

/// Removes the spawned actors, because a client that did not receive the response would
/// never remove them.
void SpawnRequest::undo() { scenes_.spawned().release(spawn_scene_, list_names_of_spawned(places)); }

}  // namespace relidar::serve
