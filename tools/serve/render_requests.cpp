// SPDX-License-Identifier: Apache-2.0
#include "render_requests.hpp"

#include <relidar/base/error.hpp>

#include "refusal.hpp"

namespace relidar::serve {
namespace {

/// Calls a function with the renderer of the requested scene, which is loaded if
/// necessary. A run that cannot be read is an error of the server, not of the client.
template <class Function>
SceneLoadNumber with_renderer(SceneSet& scenes, const RenderRequest& request, const Function& use) {
    try {
        return scenes.use_scene(request.scene, request.weather, [&](ScanRenderer& renderer) {
            renderer.count_actor_rays(request.boxes);
            use(renderer);
        });
    } catch (const DataError& error) {
        refuse(Code::INTERNAL, "{}", error.what());
    }
}

bool is_expired(const ServerContext& context) {
    return std::chrono::system_clock::now() >= context.deadline();
}

}  // namespace

/// Reserves a slot. Rejects the call without waiting if all slots are occupied.
QueueSlot reserve_slot(RenderQueue& queue) {
    if (queue.is_draining())
        refuse(Code::UNAVAILABLE, "cannot queue the request: the server is shutting down");
    std::optional<QueueSlot> slot = queue.reserve_slot();
    if (!slot)
        refuse(Code::RESOURCE_EXHAUSTED,
               "cannot queue the request: all {} slots of the queue are occupied; try again later",
               queue.total_slots());
    return std::move(*slot);
}

bool ClientRequest::is_cancelled() const { return context_.IsCancelled() || is_expired(context_); }

/// Runs the request on the render thread. If the client no longer waits for the response,
/// reverts the effects of the request and throws RejectedRequest.
void ClientRequest::run_checked(QueueSlot& slot) {
    const bool is_done = slot.run_request(*this) == RenderQueue::RequestOutcome::done;
    if (is_done && !is_cancelled()) return;
    if (is_done) revert();
    fail_cancelled(context_);
}

void fail_cancelled(const ServerContext& context) {
    if (is_expired(context))
        refuse(Code::DEADLINE_EXCEEDED,
               "cannot answer the request: its deadline has passed; set a later deadline");
    refuse(Code::CANCELLED, "cannot answer the request: the client has disconnected");
}

void ScanImageRequest::submit(bool) {
    with_renderer(scenes_, render_request_, [&](ScanRenderer& renderer) {
        scan = renderer.render(*render_request_.sensor, render_request_.request, render_request_.sample);
    });
}

PointsRequest::PointsRequest(SceneSet& scenes, const ServerContext& context,
                             std::span<const RenderRequest> requests)
    : ClientRequest(scenes, context), render_requests_(requests) {
    scene = requests.front().scene;
}

/// Submits all scans. If a scan fails, finish() still reads the earlier scans, because
/// the device returns scans in the order of their submission.
void PointsRequest::submit(bool is_last) {
    using Timing = ScanRenderer::SubmissionTiming;
    try {
        for (const RenderRequest& scan : render_requests_) {
            // Only the last scan of a batch is submitted immediately. The earlier scans
            // wait for it, so that the device receives all of them together.
            const bool is_last_scan = is_last && &scan == &render_requests_.back();
            const Timing timing = is_last_scan ? Timing::now : Timing::with_next;
            load_ = with_renderer(scenes_, scan, [&](ScanRenderer& renderer) {
                renderer.submit_points(*scan.sensor, scan.request, scan.points_at_s, scan.sample, timing);
            });
            ++n_submitted_;
        }
    } catch (...) {
        if (n_submitted_ == 0) throw;
        submit_failure_ = std::current_exception();
    }
}

void PointsRequest::finish() {
    scenes_.reuse_scene(*scene, load_, [&](ScanRenderer& renderer) {
        while (points.size() < n_submitted_) points.push_back(renderer.wait_for_points());
    });
    if (submit_failure_) std::rethrow_exception(submit_failure_);
}

void SpawnRequest::submit(bool) { occupied_slots = scenes_.spawn_actors(spawn_scene_, wishes_); }

/// Removes the actors again, because a client that did not receive the response would
/// never remove them.
void SpawnRequest::revert() {
    std::vector<std::string> names;
    for (const SpawnSlot& slot : occupied_slots) names.push_back(slot.actor.name);
    scenes_.spawned().remove_actors(spawn_scene_, names);
}

}  // namespace relidar::serve
