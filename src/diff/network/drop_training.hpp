// SPDX-License-Identifier: Apache-2.0
// Trains the ray-drop network, one step per call.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include <relidar/diff/network.hpp>

#include "diff/network/drop_inputs.hpp"
#include "diff/network/drop_loss.hpp"

namespace relidar::network {

class RayDropTraining {
public:
    /// @throws DataError in the same cases as train_drop_network()
    RayDropTraining(Device& device, const std::vector<RayDropImage>& images,
                    const RayDropNetworkOptions& options, std::uint64_t seed, bool timing = false);
    ~RayDropTraining();

    std::size_t images_per_step() const;  ///< images per step
    /// Returns the number of steps per epoch. An epoch leaves out images that do not fill
    /// a complete batch. The order is random, so each epoch leaves out other images.
    std::size_t steps_per_epoch() const;

    /// Trains the network on one batch.
    /// @param step number of the step, starting at 1
    /// @return loss and accuracy of the network before this step
    RayDropScore train_on_batch(std::span<const RotatedSample> samples, int step, int n_steps);
    RayDropNetwork download_network() const;
    /// Returns the trained parameters and their Adam moments. The caller must set the
    /// remaining fields of the state.
    RayDropTrainState download_state() const;
    /// Restores the trained parameters and their Adam moments.
    /// @throws DataError if their sizes do not match the network
    void restore_state(const RayDropTrainState& state);
    const KernelTimes& times() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar::network
