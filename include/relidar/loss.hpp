// SPDX-License-Identifier: Apache-2.0
// Image losses and their derivative with respect to what a ray renders (Eq. 10).
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include <relidar/gpu.hpp>

namespace relidar {

/// What a ray measured.
struct DeviceTarget {
    float range_m = 0.0f;     ///< 0 = dropped
    float intensity = 0.0f;
    float weight = 1.0f;      ///< 0 = unknown: takes no part in any loss
};

/// Targets of a batch of rays: those of ray k are entry first + k * stride.
struct TargetBatch {
    const Array<DeviceTarget>* targets = nullptr;
    std::uint32_t first = 0;
    std::uint32_t stride = 1;
    std::uint32_t n_rays = 0;
    double n_returned = 0.0;   ///< known rays of the batch that returned: what depth and intensity are averaged over
    double n_known = 0.0;      ///< known rays of the batch: what ray-drop is averaged over
};

/// Weights of the terms; each is a mean over its pixels.
struct LossWeights {
    float depth = 0.1f;             ///< L1 on returned rays, metres
    float intensity = 0.1f;         ///< L1 on returned rays
    float drop = 0.01f;             ///< cross-entropy on all known rays
    float opacity = 0.0f;           ///< (1 - W)^2 on returned rays (not in the paper)
    bool normalised_depth = false;  ///< compare D / W instead of D (paper)
};

inline constexpr int kLossTerms = 4;   ///< depth, intensity, drop, opacity
inline constexpr std::array<const char*, kLossTerms> kLossTermNames{"depth", "intensity", "drop", "opacity"};
inline constexpr int kUpstreamFloats = 5;   ///< d_depth, d_weight, d_intensity, d_hit_logit, d_drop_logit

class ImageLoss {
public:
    ImageLoss(Device& device, const LossWeights& weights);
    ~ImageLoss();
    /// Records the loss of a batch.
    /// @param rendered    [n_rays, kRenderedFloats] input
    /// @param upstream    [n_rays, kUpstreamFloats] output
    /// @param terms       [slots, kLossTerms] those of one slot accumulated, weighted
    void run(Stream& stream, const TargetBatch& batch, const Array<float>& rendered, Array<float>& upstream, const Array<float>& terms, std::uint32_t slot = 0);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
