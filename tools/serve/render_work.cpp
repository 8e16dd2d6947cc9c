// SPDX-License-Identifier: Apache-2.0
#include "render_work.hpp"

#include <chrono>
#include <exception>
#include <functional>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "refusal.hpp"
#include "scenes.hpp"

namespace relidar::serve {
namespace {

using Clock = std::chrono::steady_clock;

double ms_between(Clock::time_point begin, Clock::time_point end) {
    return std::chrono::duration<double, std::milli>(end - begin).count();
}

bool is_late(const grpc::ServerContext& context) {
    return std::chrono::system_clock::now() >= context.deadline();
}

/// Calls a function with the renderer of the requested scene. Error messages name the
/// folder of the run.
SceneSet::Load use(SceneSet& scenes, const WantedScan& wanted,
                   const std::function<void(ScanRenderer&)>& work) {
    try {
        return scenes.use(wanted.scene, wanted.weather, work);
    } catch (const DataError& error) {
        throw Refusal(grpc::StatusCode::INTERNAL, error.what());
    }
}

/// Renders a scan in a job on the render thread.
/// @param finish second part of the job; if it is empty, the job has only one part
template <class Scan>
Timed<Scan> timed(RenderQueue::Place& place, const grpc::ServerContext& context,
                  const std::function<void(Scan&, bool is_last)>& begin,
                  const std::function<void(Scan&)>& finish = {}, std::size_t kind = 0) {
    const Clock::time_point requested_at = Clock::now();
    Clock::time_point started_at = requested_at;
    Timed<Scan> result;
    const auto take_time = [&] { result.rendered_ms = ms_between(started_at, Clock::now()); };
    WorkInTwo work{
        [&](bool is_last) { started_at = Clock::now(), begin(result.scan, is_last), take_time(); }, {}, kind};
    if (finish) work.finish = [&] { finish(result.scan), take_time(); };
    const WorkEnd end = place.run(work, [&] { return is_wanted(context); });
    if (end == WorkEnd::unwanted || !is_wanted(context)) give_up(context);
    result.queued_ms = ms_between(requested_at, started_at);
    return result;
}

}  // namespace

bool is_wanted(const grpc::ServerContext& context) { return !context.IsCancelled() && !is_late(context); }

void give_up(const grpc::ServerContext& context) {
    if (is_late(context))
        throw Refusal(grpc::StatusCode::DEADLINE_EXCEEDED,
                      "cannot answer the request: its deadline has passed; set a later deadline");
    throw Refusal(grpc::StatusCode::CANCELLED, "cannot answer the request: the client has disconnected");
}

RenderQueue::Place enter(RenderQueue& queue) {
    std::optional<RenderQueue::Place> place = queue.enter();
    if (!place)
        throw Refusal(
            grpc::StatusCode::RESOURCE_EXHAUSTED,
            fmt::format("cannot queue the request: all {} slots of the queue are occupied; try again later",
                        queue.places()));
    return std::move(*place);
}

Timed<RenderedScan> render_scan(RenderQueue::Place& place, SceneSet& scenes, const WantedScan& wanted,
                                const grpc::ServerContext& context) {
    return timed<RenderedScan>(place, context, [&](RenderedScan& scan, bool) {
        use(scenes, wanted, [&](ScanRenderer& renderer) {
            scan = renderer.render(*wanted.sensor, wanted.request, wanted.sample);
        });
    });
}

Timed<std::vector<RenderedPoints>> render_points(RenderQueue::Place& place, SceneSet& scenes,
                                                 std::span<const WantedScan> wanted,
                                                 const grpc::ServerContext& context) {
    using Send = ScanRenderer::Send;
    std::size_t n_asked = 0;
    SceneSet::Load load{};
    // If submitting a scan fails, the earlier scans are read first, because the renderer
    // returns results in order. Only then is the error reported.
    std::exception_ptr failure;
    const auto begin = [&](std::vector<RenderedPoints>&, bool is_last) {
        try {
            for (const WantedScan& scan : wanted) {
                load = use(scenes, scan, [&](ScanRenderer& renderer) {
                    const Send when = is_last && &scan == &wanted.back() ? Send::now : Send::with_next;
                    renderer.ask_points(*scan.sensor, scan.request, scan.points_at_s, scan.sample, when);
                });
                ++n_asked;
            }
        } catch (...) {
            if (n_asked == 0) throw;
            failure = std::current_exception();
        }
    };
    const auto finish = [&](std::vector<RenderedPoints>& scans) {
        scenes.use_again(wanted.front().scene, load, [&](ScanRenderer& renderer) {
            while (scans.size() < n_asked) scans.push_back(renderer.take_points());
        });
        if (failure) std::rethrow_exception(failure);
    };
    return timed<std::vector<RenderedPoints>>(place, context, begin, finish, wanted.front().scene);
}

}  // namespace relidar::serve
