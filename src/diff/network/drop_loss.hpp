// SPDX-License-Identifier: Apache-2.0
// Computes the probability that a ray has no return (ray drop) from the network's logits.
// Also computes the cross-entropy loss and its derivative.
#pragma once

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::refine {

/// Loss and accuracy, averaged over the pixels of a batch whose measurement is known.
struct DropScore {
    double entropy = 0.0;   ///< mean cross-entropy of the measured outcomes
    double accuracy = 0.0;  ///< Share of pixels whose predicted class (return or no return) is correct.
};

/// Arrays of n pixels that DropLoss reads and writes. All addresses except `logit` may be
/// null.
struct DropLossArrays {
    Address<float, shared::DropLogits> logit;
    Address<float, shared::StartLogits> start = {};  ///< added to the logits
    /// Measured outcome: 1 for a ray without a return, 0 for a ray with a return,
    /// negative for an unknown ray.
    Address<float, shared::DropTargets> target = {};
    Address<float, shared::DropLogitGradients> d_logit = {};     ///< output: gradient of the logits
    Address<float, shared::DropProbabilities> probability = {};  ///< output: drop probabilities
};

class DropLoss {
public:
    DropLoss(Device& device, std::size_t n_pixels);

    /// Submits the kernel that computes the loss of `count` pixels.
    /// @param n_known number of pixels with a known target. The derivative is divided by
    /// this number
    void run(Stream& stream, std::size_t count, const DropLossArrays& arrays, std::size_t n_known);
    /// Returns loss and accuracy of the last run, which must be finished.
    /// @param n_known number of pixels with a known target
    DropScore score(std::size_t n_known) const;

private:
    std::uint32_t lanes_, n_parts_;
    Kernel<shared::DropLossParams> kernel_;
    Array<float, shared::PartSums> partial_;
};

}  // namespace relidar::refine
