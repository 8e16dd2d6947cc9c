// SPDX-License-Identifier: Apache-2.0
// How a call gets its scans: a place in the line, work on the render thread, and a
// refusal where the client has left.
#pragma once

#include <span>
#include <vector>

#include <grpcpp/server_context.h>

#include "render_queue.hpp"
#include "request_messages.hpp"

namespace relidar::serve {

class SceneSet;

/// Whether anybody still waits for the answer.
bool is_wanted(const grpc::ServerContext& context);
/// Of a call that nobody waits for. @throws Refusal, always
[[noreturn]] void give_up(const grpc::ServerContext& context);

/// A place in the line. @throws Refusal where all are taken
RenderQueue::Place enter(RenderQueue& queue);

/// A scan, and what it took.
template <class Scan>
struct Timed {
    Scan scan;
    double queued_ms = 0.0, rendered_ms = 0.0;
};

/// Renders a scan on the queue's thread. @throws Refusal where nobody waits for it any
/// more, or the run's folder cannot be read
Timed<RenderedScan> render_scan(RenderQueue::Place& place, SceneSet& scenes, const WantedScan& wanted,
                                const grpc::ServerContext& context);
/// How many scans one call may send to the device at once.
inline constexpr std::size_t kMostAtOnce = 8;
/// How many calls may have theirs go together: twice as many scans are in flight, since
/// the next ones are begun before these are taken.
inline constexpr std::size_t kCallsTogether = 4;
static_assert(2 * kCallsTogether * kMostAtOnce <= ScanRenderer::kScansInFlight);

/// The points alone of scans of one scene, which go to the device at once, and perhaps
/// with those of other calls.
/// @param wanted  at most kMostAtOnce
Timed<std::vector<RenderedPoints>> render_points(RenderQueue::Place& place, SceneSet& scenes,
                                                 std::span<const WantedScan> wanted,
                                                 const grpc::ServerContext& context);

}  // namespace relidar::serve
