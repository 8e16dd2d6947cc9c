// SPDX-License-Identifier: Apache-2.0
// Training of the ray-drop network, one step at a time.
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
    /// Prepares a training.
    /// @throws DataError under the same conditions as train_drop_network()
    DropTraining(Device& device, const std::vector<DropImage>& images, const RefineOptions& options,
                 std::uint64_t seed, bool timing = false);
    ~DropTraining();

    std::size_t batch() const;  ///< images per step
    /// steps per epoch; other epochs may use the images that remain
    std::size_t steps_of_epoch() const;

    /// Trains on one batch.
    /// @param step  number of the step, starting at 1
    /// @return score of the network before the step
    DropScore step(std::span<const DropInputs::Chosen> chosen, int step, int n_steps);
    DropNetwork download() const;
    /// Returns parameters and moments. The caller sets the other fields of the state.
    RefineState state() const;
    /// Restores parameters and moments.
    /// @throws DataError if their sizes do not match the network
    void restore(const RefineState& state);
    const KernelTimes& times() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar::refine
