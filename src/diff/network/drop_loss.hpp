// SPDX-License-Identifier: Apache-2.0
// Drop probabilities of the network's logits, their cross-entropy and its derivative.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Means over the known pixels of a batch.
struct DropScore {
    double entropy = 0.0;   ///< cross-entropy of the measured drops
    double accuracy = 0.0;  ///< share of pixels whose more likely class is correct
};

/// Arrays [n] that DropLoss reads and writes. All except the logits may be null.
struct DropLossArrays {
    Address<float, shared::DropLogits> logit;
    Address<float, shared::StartLogits> start = {};              ///< added to the logits
    Address<float, shared::DropTargets> target = {};             ///< 1 dropped, 0 returned, negative: unknown
    Address<float, shared::DropLogitGradients> d_logit = {};     ///< output: gradient of the logits
    Address<float, shared::DropProbabilities> probability = {};  ///< output: drop probabilities
};

class DropLoss {
public:
    DropLoss(Device& device, std::size_t n_pixels);

    /// Records the loss of n pixels.
    /// @param known  number of known pixels, the divisor of the derivative's mean
    void run(Stream& stream, std::size_t n, const DropLossArrays& arrays, std::size_t known);
    /// Returns the score of the last finished run.
    /// @param known  number of known pixels
    DropScore score(std::size_t known) const;

private:
    std::uint32_t lanes_, n_parts_;
    Kernel<shared::DropLossParams> kernel_;
    Array<float, shared::PartSums> partial_;
};

}  // namespace relidar::refine
