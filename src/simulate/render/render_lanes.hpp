// SPDX-License-Identifier: Apache-2.0
// Traces and measures the rays of sweeps on the device, several sweeps in parallel.
// Private to render.
#pragma once

#include <deque>

#include <relidar/diff/forward.hpp>

#include "simulate/render/points_on_device.hpp"
#include "simulate/render/sensor_rays.hpp"
#include "simulate/render/sweep.hpp"

namespace relidar {

class ResidentScene;

struct ParallelScanResources {
    std::unique_ptr<Renderer> copy = {};
    /// the most recently used sensor is first
    std::vector<std::shared_ptr<DeviceSensorRays>> cached;
    DevicePointComputer points;
    std::optional<RayDropRefiner> refiner = {};

    explicit ParallelScanResources(Device& device)
        : cached{std::make_shared<DeviceSensorRays>(device)}, points(device) {}
    /// @param drop_probability probability that the sensor never gets a return
    /// along a ray
    std::shared_ptr<DeviceSensorRays> upload_rays(Device& device, const SimulatedSensor& sensor,
                                                  const RayTable& rays, const RayFunction& drop_probability);
};

/// A lane renders one scan at a time.
class ParallelScanResourcePool {
public:
    ParallelScanResourcePool(Device& device, ResidentScene& scene);

    ParallelScanResources& single_lane() { return first_; }
    /// Returns a lane for the next scan of a batch. Begins a batch if there is none.
    ParallelScanResources& next_lane();
    bool has_open_batch() const { return batch_.has_value(); }
    void submit_batch();
    Renderer& renderer_of(const ParallelScanResources& lane);

    /// An empty network turns the correction off.
    void use_network(const RayDropNetwork& network);
    /// Null if there is no network.
    const RayDropNetwork* drop_network() const {
        return first_.refiner ? &first_.refiner->network() : nullptr;
    }
    RayDropRefiner& refiner_of(ParallelScanResources& lane);
    /// Calls a function for each copy of the scene. If memory is exhausted, removes the
    /// copies.
    void change_copies(const std::function<void(Renderer&)>& change);
    void remove_copies() { others_.clear(); }
    int parallel_limit() const { return most_; }
    void set_limit(int count);

private:
    Device& device_;
    ResidentScene& scene_;
    ParallelScanResources first_;
    std::deque<ParallelScanResources> others_ = {};  ///< lanes for further parallel scans
    int most_;
    std::optional<ConcurrentSequenceScope> batch_ = {};
    std::size_t n_batch_ = 0;  ///< number of scans in the batch
};

}  // namespace relidar
