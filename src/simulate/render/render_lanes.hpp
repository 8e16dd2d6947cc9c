// SPDX-License-Identifier: Apache-2.0
// Keeps what the device needs to render several scans in parallel: a lane for each scan.
// Private to render.
#pragma once

#include <deque>

#include <relidar/diff/forward.hpp>

#include "simulate/render/points_on_device.hpp"
#include "simulate/render/resident_scene.hpp"
#include "simulate/render/sensor_rays.hpp"
#include "simulate/render/sweep.hpp"

namespace relidar {

/// Buffers with which the device renders one scan at a time. The first lane renders the
/// scene itself, other lanes render copies of it.
class RenderLane {
public:
    /// @param scene_copy null for the first lane
    RenderLane(Device& device, ResidentScene& scene, std::unique_ptr<Renderer> scene_copy = {},
               const RayDropNetwork* network = nullptr)
        : points(device),
          device_(device),
          scene_(scene),
          copy_(std::move(scene_copy)),
          cached_{std::make_shared<DeviceSensorRays>(device)} {  // compiles the kernels now
        if (network) refiner.emplace(device, *network);
    }

    DevicePointComputer points;
    std::optional<RayDropRefiner> refiner = {};  ///< empty if no ray-drop network is used

    Renderer& renderer() { return copy_ ? *copy_ : scene_.renderer(); }
    /// Returns the rays of a sensor on the device. Uploads them unless they are cached.
    /// @param drop_probability that the sensor never gets a return along a ray
    std::shared_ptr<DeviceSensorRays> upload_rays(const SimulatedSensor& sensor, const RayTable& ray_table,
                                                  const RayFunction& drop_probability);

private:
    Device& device_;
    ResidentScene& scene_;
    std::unique_ptr<Renderer> copy_;
    std::vector<std::shared_ptr<DeviceSensorRays>> cached_;  ///< the most recently used first

    void trim_cache();
};

/// Lanes, and the batch of recorded scans that the device will render in parallel.
class RenderLanes {
public:
    RenderLanes(Device& device, ResidentScene& scene);

    RenderLane& first() { return lanes_.front(); }
    /// Returns the lane for the next scan. A scan with `with_next` and those that follow
    /// it form a batch, unless the limit is one scan.
    RenderLane& choose_lane(ScanRenderer::SubmissionTiming timing);
    /// Submits the recorded scans, unless their batch waits for the next scan.
    void submit(ScanRenderer::SubmissionTiming timing);
    void submit_batch();

    /// An empty network turns the correction off.
    void use_network(const RayDropNetwork& network);
    /// Null if there is no network.
    const RayDropNetwork* drop_network() const {
        return lanes_.front().refiner ? &lanes_.front().refiner->network() : nullptr;
    }
    /// Calls a function for each copy of the scene. If memory is exhausted, removes the
    /// copies.
    void change_copies(const std::function<void(Renderer&)>& change);
    void remove_copies() { keep_lanes(1); }
    int parallel_limit() const { return scene_.has_blocks() ? 1 : limit_; }
    void set_limit(int count);

private:
    Device& device_;
    ResidentScene& scene_;
    std::deque<RenderLane> lanes_ = {};
    int limit_;  ///< falls to the number of lanes that fit into the device memory
    std::optional<ConcurrentSequenceScope> batch_ = {};
    std::size_t n_batch_ = 0;  ///< number of scans in the batch

    void begin_batch();
    void keep_lanes(std::size_t count);
};

}  // namespace relidar
