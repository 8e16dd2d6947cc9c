// SPDX-License-Identifier: Apache-2.0
// Renders the scans of gRPC calls. Each call reserves a slot in the queue and runs its
// job on the render thread. The call fails if its client has disconnected.
#pragma once

#include <span>
#include <vector>

#include <grpcpp/server_context.h>

#include "render_queue.hpp"
#include "request_messages.hpp"

namespace relidar::serve {

class SceneSet;

/// Returns true if the client is still connected and the deadline of the call has not
/// passed.
bool is_wanted(const grpc::ServerContext& context);
/// Ends a call after its client has disconnected or its deadline has passed.
/// @throws Refusal always
[[noreturn]] void give_up(const grpc::ServerContext& context);

/// Reserves a slot in the queue of render jobs.
/// @throws Refusal if the queue is full
RenderQueue::Place enter(RenderQueue& queue);

/// A rendered scan, and how long it waited and rendered.
template <class Scan>
struct Timed {
    Scan scan;
    double queued_ms = 0.0, rendered_ms = 0.0;
};

/// Renders a scan on the render thread.
/// @throws Refusal if the client no longer waits, or if the folder of the run cannot be
/// read
Timed<RenderedScan> render_scan(RenderQueue::Place& place, SceneSet& scenes, const WantedScan& wanted,
                                const grpc::ServerContext& context);
/// Maximum number of scans that one call submits to the device together.
inline constexpr std::size_t kMostAtOnce = 8;
/// Maximum number of calls whose scans are submitted to the device together. The device
/// may hold twice as many scans, because the next scans are submitted before these are
/// read.
inline constexpr std::size_t kCallsTogether = 4;
static_assert(2 * kCallsTogether * kMostAtOnce <= ScanRenderer::kScansInFlight);

/// Renders several scans of one scene and returns only their points. The scans are
/// submitted to the device together. They may be submitted together with scans of other
/// calls.
/// @param wanted at most kMostAtOnce scans
Timed<std::vector<RenderedPoints>> render_points(RenderQueue::Place& place, SceneSet& scenes,
                                                 std::span<const WantedScan> wanted,
                                                 const grpc::ServerContext& context);

}  // namespace relidar::serve
