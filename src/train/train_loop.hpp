// SPDX-License-Identifier: Apache-2.0
// One training iteration and everything it touches on the device.
#pragma once

#include <optional>
#include <utility>

#include <relidar/backward.hpp>
#include <relidar/densify.hpp>
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
    /// What densification has done since the last call.
    DensifyReport take_densified() { return std::exchange(densified_, {}); }
    /// Removes surfels that get no gradient from any ray of any training frame (densify.prune_unseen). Blocks.
    void prune_unseen();
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
    std::optional<Accel> accel_;
    ForwardPass forward_;
    ImageLoss loss_;
    BackwardPass backward_;
    Adam adam_;
    std::optional<Gradients> gradients_;
    std::optional<Densifier> densifier_;   ///< where the config wants one
    DensifyReport densified_;              ///< since the last log line
    Array<float> rendered_, upstream_, terms_;
    double extent_m_;
    FrameSampler sampler_;

    std::uint32_t largest_batch() const;
    template <class Change>
    void change_surfels(const Change& change);
};

}  // namespace relidar
