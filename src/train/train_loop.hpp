// SPDX-License-Identifier: Apache-2.0
// One training iteration and everything it touches on the device.
#pragma once

#include <relidar/backward.hpp>
#include <relidar/forward.hpp>
#include <relidar/optimizer.hpp>
#include <relidar/train.hpp>

#include "core/random.hpp"
#include "train/frame_data.hpp"

namespace relidar {

/// Frames in random order, each once an epoch.
class FrameSampler {
public:
    FrameSampler(std::size_t n, std::uint64_t seed);
    std::size_t next();
    Random& random() { return random_; }

private:
    std::vector<std::size_t> order_;
    std::size_t position_ = 0;
    Random random_;
};

class TrainLoop {
public:
    TrainLoop(Device& device, const Sequence& sequence, const Split& split, const Scene& initial, const Config& config);

    /// Records and submits one iteration. @param step counts from 1
    void iterate(int step);
    /// Mean loss terms over the last n iterations; starts over. Blocks. @throws DataError where a term is not finite
    std::array<double, kLossTerms> take_terms(int n, int step);
    /// Sensor-level ray-drop, from rays for which the scene as it is now expects a return. Blocks.
    DropTable estimate_sensor_drop(const Sequence& sequence);
    /// The scene as it is now. Blocks.
    Scene download();
    const KernelTimes& times() const { return stream_.times(); }
    std::uint32_t n_surfels() const { return scene_.size(); }

private:
    const Config& config_;
    std::vector<FrameData> frames_;
    Stream stream_;
    DeviceScene scene_;
    Accel accel_;
    ForwardPass forward_;
    ImageLoss loss_;
    BackwardPass backward_;
    Adam adam_;
    Gradients gradients_;
    Array<float> rendered_;
    KeptHits kept_;
    Array<float> upstream_, terms_;
    double extent_m_;
    FrameSampler sampler_;

    std::uint32_t largest_batch() const;
    /// Deterministic training: hits of the last n iterations against the room for their records; makes more. @throws DeviceError where a step did not fit
    void check_room(int n, int step);
};

}  // namespace relidar
