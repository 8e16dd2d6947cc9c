// SPDX-License-Identifier: Apache-2.0
// Renders scans for calls: gets a place in the queue, runs a job on the render thread,
// and fails if the client has disconnected.
#pragma once

#include <span>
#include <vector>

#include <grpcpp/server_context.h>

#include "render_queue.hpp"
#include "request_messages.hpp"

namespace relidar::serve {

class SceneSet;

/// Returns false if the client has disconnected or the deadline has passed.
bool is_wanted(const grpc::ServerContext& context);
/// Ends a call whose client no longer waits.
/// @throws Refusal always
[[noreturn]] void give_up(const grpc::ServerContext& context);

/// Returns a place in the queue.
/// @throws Refusal if the queue is full
RenderQueue::Place enter(RenderQueue& queue);

/// A scan with its waiting time and rendering time.
template <class Scan>
struct Timed {
    Scan scan;
    double queued_ms = 0.0, rendered_ms = 0.0;
};

/// Renders a scan on the queue's thread.
/// @throws Refusal if the client no longer waits, or the folder of the run cannot be read
Timed<RenderedScan> render_scan(RenderQueue::Place& place, SceneSet& scenes, const WantedScan& wanted,
                                const grpc::ServerContext& context);
/// Maximum number of scans that one call submits to the device together.
inline constexpr std::size_t kMostAtOnce = 8;
/// Maximum number of calls whose scans are submitted together. Twice as many scans can be
/// pending, because the next scans are submitted before these are read.
inline constexpr std::size_t kCallsTogether = 4;
static_assert(2 * kCallsTogether * kMostAtOnce <= ScanRenderer::kScansInFlight);

/// Renders only the points of several scans of one scene. The scans are submitted to the
/// device together, possibly with scans of other calls.
/// @param wanted at most kMostAtOnce scans
Timed<std::vector<RenderedPoints>> render_points(RenderQueue::Place& place, SceneSet& scenes,
                                                 std::span<const WantedScan> wanted,
                                                 const grpc::ServerContext& context);

}  // namespace relidar::serve
