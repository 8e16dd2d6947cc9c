// SPDX-License-Identifier: Apache-2.0
// Computes drop probabilities from the network's logits, their cross-entropy, and its
// derivative.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Means over the known pixels of a batch.
struct DropScore {
    double entropy = 0.0;   ///< cross-entropy of the measured drops
    double accuracy = 0.0;  ///< Share of pixels for which the more likely class is correct.
};

/// Arrays of n pixels that DropLoss reads and writes. All arrays except the logits may be
/// null.
struct DropLossArrays {
    Address<float, shared::DropLogits> logit;
    Address<float, shared::StartLogits> start = {};  ///< added to the logits
    /// Targets: 1 for a dropped ray, 0 for a return, negative for an unknown ray.
    Address<float, shared::DropTargets> target = {};
    Address<float, shared::DropLogitGradients> d_logit = {};     ///< output: gradient of the logits
    Address<float, shared::DropProbabilities> probability = {};  ///< output: drop probabilities
};

class DropLoss {
public:
    DropLoss(Device& device, std::size_t n_pixels);

    /// Submits the kernel that computes the loss of n pixels.
    /// @param known  number of pixels with a known target, by which the derivative is
    /// divided
    void run(Stream& stream, std::size_t n, const DropLossArrays& arrays, std::size_t known);
    /// Returns loss and accuracy of the last finished run.
    /// @param known  number of pixels with a known target
    DropScore score(std::size_t known) const;

private:
    std::uint32_t lanes_, n_parts_;
    Kernel<shared::DropLossParams> kernel_;
    Array<float, shared::PartSums> partial_;
};

}  // namespace relidar::refine
