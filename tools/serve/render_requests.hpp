// SPDX-License-Identifier: Apache-2.0
// Defines the requests of gRPC calls to the render thread, and their responses.
#pragma once

#include <exception>
#include <span>
#include <vector>

#include <grpcpp/server_context.h>

#include "render_queue.hpp"
#include "request_messages.hpp"
#include "scenes.hpp"

namespace relidar::serve {

/// Reserves a slot in the queue.
/// @throws Refusal if the queue is full
RenderQueue::Slot reserve(RenderQueue& queue);

/// Ends a call whose client has disconnected or whose deadline has passed.
/// @throws Refusal always
[[noreturn]] void refuse_cancelled(const grpc::ServerContext& context);

/// A request of a client.
class ClientRequest : public Request {
public:
    ClientRequest(SceneSet& scenes, const grpc::ServerContext& context)
        : scenes_(scenes), context_(context) {}
    bool is_cancelled() const override;
    /// Runs the request and waits for the response.
    /// @throws Refusal if the client has disconnected or the deadline has passed, or if
    /// the folder of the run cannot be read
    void run(RenderQueue::Slot& slot);

protected:
    SceneSet& scenes_;
    /// Undoes the effects of a request whose client no longer waits for the response.
    virtual void undo() {}

private:
    const grpc::ServerContext& context_;
};

/// Renders a scan with all its arrays.
class ScanImageRequest final : public ClientRequest {
public:
    ScanImageRequest(SceneSet& scenes, const grpc::ServerContext& context, const RenderRequest& wanted)
        : ClientRequest(scenes, context), wanted_(wanted) {}
    void submit(bool is_last) override;

    RenderedScan scan;  ///< the response

private:
    const RenderRequest& wanted_;
};

/// Maximum number of scans of a PointsRequest.
inline constexpr std::size_t kMostAtOnce = 8;
/// Maximum number of requests in a batch. The device may hold twice as many scans,
/// because the next scans are submitted before these are read.
inline constexpr std::size_t kBatchSize = 4;
static_assert(2 * kBatchSize * kMostAtOnce <= ScanRenderer::kScansInFlight);

/// Renders several scans of one scene and returns only their points. The device can
/// render the scans together with scans of other requests.
class PointsRequest final : public ClientRequest {
public:
    /// @param wanted at most kMostAtOnce scans
    PointsRequest(SceneSet& scenes, const grpc::ServerContext& context,
                  std::span<const RenderRequest> wanted);
    void submit(bool is_last) override;
    void finish() override;

    std::vector<RenderedPoints> points;  ///< the response

private:
    const std::span<const RenderRequest> wanted_;
    SceneSet::Load load_{};
    std::size_t n_submitted_ = 0;
    /// If submitting a scan fails, the earlier scans are read first, because the renderer
    /// returns results in order. Only then is the error reported.
    std::exception_ptr submit_failure_ = {};
};

/// Spawns actors in a scene.
class SpawnRequest final : public ClientRequest {
public:
    SpawnRequest(SceneSet& scenes, const grpc::ServerContext& context, std::size_t spawn_scene,
                 const std::vector<ActorToSpawn>& wishes)
        : ClientRequest(scenes, context), spawn_scene_(spawn_scene), wishes_(wishes) {}
    void submit(bool is_last) override;

    std::vector<SpawnedActors::Place> places;  ///< the response

private:
    void undo() override;
    const std::size_t spawn_scene_;
    const std::vector<ActorToSpawn>& wishes_;
};

}  // namespace relidar::serve
