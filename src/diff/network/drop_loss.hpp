// SPDX-License-Identifier: Apache-2.0
// Computes the probability that a ray has no return (ray drop) from the network's logits.
// Also computes the cross-entropy loss and its derivative.
#pragma once

#include <algorithm>

#include "diff/network/tensor.hpp"
#include "gpu/stream.hpp"

namespace relidar::network {

struct RayDropScore {
    double entropy = 0.0;   ///< mean cross-entropy of the measured outcomes
    double accuracy = 0.0;  ///< Share of pixels whose predicted class (return or no return) is correct.
};

/// Arrays of n pixels that RayDropLoss reads and writes. Only `logit` must not be null.
struct RayDropLossArrays {
    Address<float, shared::DropLogits> logit;
    Address<float, shared::StartLogits> start = {};  ///< added to the logits
    /// 1 if the LiDAR measured no return for the ray, 0 if it measured a return, negative
    /// if unknown
    Address<float, shared::DropTargets> target = {};
    Address<float, shared::DropLogitGradients> d_logit = {};     ///< output: gradient of the logits
    Address<float, shared::DropProbabilities> probability = {};  ///< output: drop probabilities
};

class RayDropLoss {
public:
    RayDropLoss(Device& device, std::size_t n_pixels)
        : device_(device), n_parts_(std::uint32_t(std::max<std::size_t>(1, n_pixels / kPixelsOfPart))) {}

    /// @param n_known number of pixels with a known target; divides the derivative
    void record_loss(Stream& stream, std::size_t n, const RayDropLossArrays& arrays, std::size_t n_known);
    /// The last run must be finished.
    RayDropScore read_loss(std::size_t n_known_pixels) const;

private:
    static constexpr std::uint32_t kThreads = 64;  ///< threads per workgroup
    static constexpr std::size_t kPixelsOfPart = 2048;

    Device& device_;
    std::uint32_t n_parts_, lanes_ = std::uint32_t(device_.info().subgroup_size);
    Kernel<shared::DropLossParams> kernel_{
        device_,
        "diff/network/drop_loss",
        {{SpecialisationConstantId::LANES, lanes_}, {SpecialisationConstantId::WORKGROUP_SIZE, kThreads}},
        SubgroupRequirement::full};
    Array<float, shared::PartSums> partial_{device_, 2 * n_parts_, "sums of cross-entropies"};
};

}  // namespace relidar::network
