// SPDX-License-Identifier: Apache-2.0
// Computes the returns of a conical beam in the synthetic street, and the two returns
// that a receiver reports. Only the reader of synthetic logs uses this file.
#pragma once

#include <relidar/log/sequence.hpp>

namespace relidar::street {

inline constexpr int kConeRays = 53;  ///< number of thin rays that sample the cone of a beam

/// Replaces each ray by kConeRays thin rays along a spiral that covers the ray's cone
/// evenly.
/// @param rays  rays with a divergence
RayTable cone_rays(const RayTable& rays);

/// Computes two returns per ray from the hits in its cone. Hits with range steps below
/// 0.5 m form one return, whose range is their mean weighted by light. The first return
/// is the strongest. The second return is the last, or the next strongest if the
/// strongest is the last. The second return must have at least a tenth of the strongest's
/// light. A ray is dropped if at most half of its cone has hits.
/// @param cone  scan with the hits of the rays from cone_rays(rays)
Scan receive(const RayTable& rays, const Scan& cone);

}  // namespace relidar::street
