// SPDX-License-Identifier: Apache-2.0
// What a network's logits are worth: drop probabilities, their cross-entropy and its
// derivative.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Mean over the known pixels of a batch.
struct DropScore {
    double entropy = 0.0;   ///< of what happened
    double accuracy = 0.0;  ///< share of pixels of which the likelier answer is right
};

/// What DropLoss reads and writes, [n]; all but the logits may be nowhere.
struct DropLossArrays {
    Address<float, shared::DropLogits> logit;
    Address<float, shared::StartLogits> start = {};           ///< added to the logits
    Address<float, shared::DropTargets> target = {};          ///< 1 dropped, 0 returned, negative: not known
    Address<float, shared::DropLogitGradients> d_logit = {};  ///< output
    Address<float, shared::DropProbabilities> probability = {};  ///< output
};

class DropLoss {
public:
    DropLoss(Device& device, std::size_t n_pixels);

    /// Records it for n pixels. @param known  pixels, over which the derivative's mean is
    /// taken
    void run(Stream& stream, std::size_t n, const DropLossArrays& arrays, std::size_t known);
    /// Of the last run that is done. @param known  pixels
    DropScore score(std::size_t known) const;

private:
    std::uint32_t lanes_, n_parts_;
    Kernel<shared::DropLossParams> kernel_;
    Array<float, shared::PartSums> partial_;
};

}  // namespace relidar::refine
