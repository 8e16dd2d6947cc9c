// SPDX-License-Identifier: Apache-2.0
// The requests that gRPC calls send to the render thread, and their responses.
#pragma once

#include <grpcpp/server_context.h>

#include "render_queue.hpp"
#include "request_messages.hpp"
#include "scenes.hpp"

namespace relidar::serve {

using grpc::ServerContext;

QueueSlot reserve_slot(RenderQueue& queue);

[[noreturn]] void fail_cancelled(const ServerContext& context);

class ClientRequest : public QueuedRequest {
public:
    ClientRequest(SceneSet& scenes, const ServerContext& context) : scenes_(scenes), context_(context) {}
    bool is_cancelled() const override;
    void run_checked(QueueSlot& slot);

protected:
    SceneSet& scenes_;
    virtual void revert() {}

private:
    const ServerContext& context_;
};

class ScanImageRequest final : public ClientRequest {
public:
    ScanImageRequest(SceneSet& scenes, const ServerContext& context, const RenderRequest& request)
        : ClientRequest(scenes, context), render_request_(request) {}
    void submit(bool is_last) override;

    RenderedScan scan;  ///< the response

private:
    const RenderRequest& render_request_;
};

inline constexpr std::size_t kMostAtOnce = 8;
/// The device can hold two batches.
inline constexpr std::size_t kBatchSize = 4;
static_assert(2 * kBatchSize * kMostAtOnce <= ScanRenderer::kScansInFlight);

/// Only points. The device can render them together with scans of other requests.
class PointsRequest final : public ClientRequest {
public:
    PointsRequest(SceneSet& scenes, const ServerContext& context, std::span<const RenderRequest> requests);
    void submit(bool is_last) override;
    void finish() override;

    std::vector<RenderedPoints> points;  ///< the response

private:
    const std::span<const RenderRequest> render_requests_;
    SceneLoadNumber load_{};
    std::size_t n_submitted_ = 0;
    /// Thrown again after the earlier scans are read, because scans return in order.
    std::exception_ptr submit_failure_ = {};
};

class SpawnRequest final : public ClientRequest {
public:
    SpawnRequest(SceneSet& scenes, const ServerContext& context, std::size_t spawn_scene,
                 const std::vector<ActorToSpawn>& actors)
        : ClientRequest(scenes, context), spawn_scene_(spawn_scene), wishes_(actors) {}
    void submit(bool is_last) override;

    std::vector<SpawnSlot> occupied_slots;  ///< the response

private:
    void revert() override;
    const std::size_t spawn_scene_;
    const std::vector<ActorToSpawn>& wishes_;
};

}  // namespace relidar::serve
