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

namespace relidar::refine {

class DropTraining {
public:
    /// Uploads the images, and creates the network and the optimizer.
    /// @throws DataError in the same cases as train_drop_network()
    DropTraining(Device& device, const std::vector<DropImage>& images, const RefineOptions& options,
                 std::uint64_t seed, bool timing = false);
    ~DropTraining();

    std::size_t batch() const;  ///< images per step
    /// Returns the number of steps per epoch. Images that do not fill the last batch are
    /// left out. The order is random, so other images are left out in the next epoch.
    std::size_t count_steps_per_epoch() const;

    /// Trains the network on one batch.
    /// @param step number of the step, starting at 1
    /// @return loss and accuracy of the network before this step
    DropScore step(std::span<const DropInputs::Chosen> chosen, int step, int n_steps);
    DropNetwork download() const;
    /// Returns the trained parameters and their Adam moments. The caller must set the
    /// remaining fields of the state.
    RefineState state() const;
    /// Restores the trained parameters and their Adam moments.
    /// @throws DataError if their sizes do not match the network
    void restore(const RefineState& state);
    const KernelTimes& times() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar::refine
