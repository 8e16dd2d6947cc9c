// SPDX-License-Identifier: Apache-2.0
#include "render_work.hpp"

#include <chrono>
#include <functional>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "refusal.hpp"
#include "scenes.hpp"

namespace relidar::serve {
namespace {

using Clock = std::chrono::steady_clock;

double ms_between(Clock::time_point begin, Clock::time_point end) { return std::chrono::duration<double, std::milli>(end - begin).count(); }

bool is_late(const grpc::ServerContext& context) { return std::chrono::system_clock::now() >= context.deadline(); }

/// What a scene's renderer does for a request, which has been looked at: the run's folder is at fault where it fails.
void use(SceneSet& scenes, const WantedScan& wanted, const std::function<void(ScanRenderer&)>& work) {
    try {
        scenes.use(wanted.scene, wanted.weather, work);
    } catch (const DataError& error) {
        throw Refusal(grpc::StatusCode::INTERNAL, error.what());
    }
}

/// Has a scan made on the queue's thread. @param finish  none: the work has one part
template <class Scan>
Timed<Scan> timed(RenderQueue::Place& place, const grpc::ServerContext& context, const std::function<void(Scan&)>& begin,
                  const std::function<void(Scan&)>& finish = {}, std::size_t kind = 0) {
    const Clock::time_point asked = Clock::now();
    Clock::time_point begun = asked;
    Timed<Scan> result;
    const auto part = [&](const std::function<void(Scan&)>& work) {
        work(result.scan);
        result.rendered_ms = ms_between(begun, Clock::now());
    };
    WorkInTwo work{[&] { begun = Clock::now(), part(begin); }, {}, kind};
    if (finish) work.finish = [&] { part(finish); };
    const WorkEnd end = place.run(work, [&] { return is_wanted(context); });
    if (end == WorkEnd::unwanted || !is_wanted(context)) give_up(context);
    result.queued_ms = ms_between(asked, begun);
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
    return timed<RenderedScan>(place, context, [&](RenderedScan& scan) {
        use(scenes, wanted, [&](ScanRenderer& renderer) { scan = renderer.render(*wanted.sensor, wanted.request, wanted.sample); });
    });
}

Timed<PointScan> render_points(RenderQueue::Place& place, SceneSet& scenes, const WantedScan& wanted, const grpc::ServerContext& context) {
    const auto begin = [&](PointScan&) {
        use(scenes, wanted, [&](ScanRenderer& renderer) {
            renderer.ask_points(*wanted.sensor, wanted.request, wanted.points_at_s, wanted.sample);
        });
    };
    const auto finish = [&](PointScan& scan) {
        scenes.use_again(wanted.scene, [&](ScanRenderer& renderer) { scan = renderer.take_points(); });
    };
    return timed<PointScan>(place, context, begin, finish, wanted.scene);
}

}  // namespace relidar::serve
