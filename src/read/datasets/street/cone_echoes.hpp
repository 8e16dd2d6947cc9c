// SPDX-License-Identifier: Apache-2.0
// Computes the two returns that a receiver reports for a conical beam in the synthetic
// street. Only the reader of synthetic logs uses this file.
#pragma once

#include <relidar/log/sequence.hpp>

namespace relidar::street {

inline constexpr int kConeRays = 53;  ///< number of thin rays that represent the cone of a beam

/// Replaces each ray by kConeRays thin rays, which form a spiral in its cone (the
/// divergence).
RayTable make_cone_rays(const RayTable& rays);

/// Computes two returns per ray from the hits in the cone of the beam. Hits whose ranges
/// differ by less than 0.5 m from the next hit form one return. The range of the return
/// is their mean, weighted by light.
///
/// The first return is the strongest one. The second return is the last one, or the next
/// strongest one if the strongest return is the last. The second return must have at
/// least a tenth of the light of the first. If at most half of the thin rays have hits,
/// the ray is dropped.
/// @param scan_of_cone_rays  scan with the hits of the rays from make_cone_rays(rays)
Scan combine_cone(const RayTable& rays, const Scan& scan_of_cone_rays);

}  // namespace relidar::street
