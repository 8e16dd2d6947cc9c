// SPDX-License-Identifier: Apache-2.0
// A training of the ray-drop network, step by step.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <relidar/refine.hpp>
#include <relidar/stages/optimizer.hpp>

#include "refine/drop_inputs.hpp"
#include "refine/drop_loss.hpp"
#include "refine/unet.hpp"

namespace relidar::refine {

class DropTraining {
public:
    /// @throws DataError as train_drop_network
    DropTraining(Device& device, const std::vector<DropImage>& images, const RefineOptions& options, std::uint64_t seed,
                 bool timing = false);

    std::size_t batch() const { return batch_; }
    std::size_t steps_of_epoch() const { return n_images_ / batch_; }   // the rest of an epoch's images is another one's turn

    /// One step on a batch. @param step  counts from 1 @return what the network scored before it
    DropScore step(std::span<const DropInputs::Chosen> chosen, int step, int n_steps);
    DropNetwork download() const;
    const KernelTimes& times() const { return stream_.times(); }

private:
    DropNetwork network_;
    RefineOptions options_;
    std::size_t n_images_, batch_;
    Grid grid_;
    DropInputs inputs_;
    Unet unet_;
    DropLoss loss_;
    ArrayAdam adam_;
    Stream stream_;
};

}  // namespace relidar::refine
