// SPDX-License-Identifier: Apache-2.0
// A training of the ray-drop network, step by step.
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
    /// @throws DataError as train_drop_network
    DropTraining(Device& device, const std::vector<DropImage>& images, const RefineOptions& options,
                 std::uint64_t seed, bool timing = false);
    ~DropTraining();

    std::size_t batch() const;           ///< images a step
    std::size_t steps_of_epoch() const;  ///< the rest of an epoch's images is another one's turn

    /// One step on a batch. @param step  counts from 1 @return what the network scored
    /// before it
    DropScore step(std::span<const DropInputs::Chosen> chosen, int step, int n_steps);
    DropNetwork download() const;
    /// Parameters and moments; the rest of a state is the caller's.
    RefineState state() const;
    /// @throws DataError where they are not as many as this network's
    void restore(const RefineState& state);
    const KernelTimes& times() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar::refine
