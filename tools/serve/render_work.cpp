// SPDX-License-Identifier: Apache-2.0
#include "render_work.hpp"

#include <chrono>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "refusal.hpp"
#include "scenes.hpp"

namespace relidar::serve {
namespace {

using Clock = std::chrono::steady_clock;

double ms_between(Clock::time_point begin, Clock::time_point end) { return std::chrono::duration<double, std::milli>(end - begin).count(); }

bool is_late(const grpc::ServerContext& context) { return std::chrono::system_clock::now() >= context.deadline(); }

/// Has a scan rendered on the queue's thread.
template <class Scan, class Render>
Timed<Scan> timed(RenderQueue::Place& place, const WantedScan& wanted, const grpc::ServerContext& context, SceneSet& scenes,
                  const Render& render) {
    const Clock::time_point asked = Clock::now();
    Clock::time_point begun = asked, rendered = asked;
    Timed<Scan> result;
    const auto work = [&] {
        begun = Clock::now();
        try {
            scenes.use(wanted.scene, wanted.weather, [&](ScanRenderer& renderer) { result.scan = render(renderer); });
        } catch (const DataError& error) {   // the request has been looked at: the run's folder is at fault
            throw Refusal(grpc::StatusCode::INTERNAL, error.what());
        }
        rendered = Clock::now();
    };
    const WorkEnd end = place.run(work, [&] { return is_wanted(context); });
    if (end == WorkEnd::unwanted || !is_wanted(context)) give_up(context);
    result.queued_ms = ms_between(asked, begun);
    result.rendered_ms = ms_between(begun, rendered);
    return result;
}

}  // namespace

bool is_wanted(const grpc::ServerContext& context) { return !context.IsCancelled() && !is_late(context); }

void give_up(const grpc::ServerContext& context) {
    if (is_late(context))
        throw Refusal(grpc::StatusCode::DEADLINE_EXCEEDED, "answering a request: found the deadline passed, expected a later one");
    throw Refusal(grpc::StatusCode::CANCELLED, "answering a request: the client has left");
}

RenderQueue::Place enter(RenderQueue& queue) {
    std::optional<RenderQueue::Place> place = queue.enter();
    if (!place)
        throw Refusal(grpc::StatusCode::RESOURCE_EXHAUSTED,
                      fmt::format("queueing a request: found all {} places taken, expected a free one: try again later", queue.places()));
    return std::move(*place);
}

Timed<RenderedScan> render_scan(RenderQueue::Place& place, SceneSet& scenes, const WantedScan& wanted, const grpc::ServerContext& context) {
    return timed<RenderedScan>(place, wanted, context, scenes, [&](ScanRenderer& renderer) {
        return renderer.render(*wanted.sensor, wanted.request, wanted.sample);
    });
}

Timed<PointScan> render_points(RenderQueue::Place& place, SceneSet& scenes, const WantedScan& wanted, const grpc::ServerContext& context) {
    return timed<PointScan>(place, wanted, context, scenes, [&](ScanRenderer& renderer) {
        renderer.ask_points(*wanted.sensor, wanted.request, wanted.points_at_s, wanted.sample);
        return renderer.take_points();
    });
}

}  // namespace relidar::serve
