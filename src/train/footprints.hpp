// SPDX-License-Identifier: Apache-2.0
// Beams of a training step cast as what they are, cones: several rays each, joined before the losses (train.sub_rays, method.md M14).
#pragma once

#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/stages/traversal.hpp>

#include "gpu/kernel.hpp"
#include "shared/train.h"

namespace relidar {

class Footprints {
public:
    /// @param n_parts       rays of a beam, 5 or 9 @throws UsageError for another number
    /// @param n_beams       of the largest batch
    /// @param unexplained   share u of a part that does not explain what was measured, above 0
    Footprints(Device& device, int n_parts, std::uint32_t n_beams, double unexplained);

    /// Records the rays of a batch's parts, each with its beam's target. They serve until the next call.
    /// @param divergence_rad  full divergence of all beams
    RayBatch split(Stream& stream, const RayBatch& beams, double divergence_rad);
    /// Records what the beams render. @param parts  of split() @return what losses compare, and where their gradients go
    RenderedBatch join(Stream& stream, const RayBatch& beams, const RenderedBatch& parts);
    /// Records the gradients of the parts from those that losses have left for the beams.
    void spread(Stream& stream, const RenderedBatch& parts);
    /// Records dL/d(ray) of the beams in place of those of their parts. @param d_rays [n_parts * n_beams, 6] becomes [n_beams, 6]
    void sum_ray_gradients(Stream& stream, const Array<float>& d_rays);

private:
    const std::vector<glm::vec2> pattern_;
    const float unexplained_;
    std::uint32_t n_beams_ = 0;   ///< of the last batch
    Array<DeviceRay> rays_;
    Array<shared::DeviceTarget> targets_;
    Array<shared::RenderedRay> rendered_;
    Array<shared::RayGradient> upstream_;
    RayGeometry geometry_;
    Array<float, shared::DeviceRayGradients> ray_gradients_;
    Kernel<shared::SplitBeamsParams> split_;
    Kernel<shared::SplitBeamsVjpParams> split_vjp_;
    Kernel<shared::JoinBeamsParams> join_, join_vjp_;

    std::uint32_t n_parts() const { return static_cast<std::uint32_t>(pattern_.size()); }
    shared::JoinBeamsParams join_params(const RenderedBatch& parts) const;
};

}  // namespace relidar
