// SPDX-License-Identifier: Apache-2.0
// Returns of a conical beam in the synthetic street, and the two returns that a receiver
// reports. Private to the reader.
#pragma once

#include <relidar/log/sequence.hpp>

namespace relidar::street {

inline constexpr int kConeRays = 53;  ///< exact rays per beam

/// Replaces each ray by kConeRays rays in a spiral that covers its cone evenly.
/// @param rays  rays with a divergence
RayTable cone_rays(const RayTable& rays);

/// Computes two returns per ray from the hits in its cone. Hits that are connected by
/// range steps below 0.5 m form one return. Its range is the mean of the hits, weighted
/// by their light. The first return is the strongest one. The second is the last one, or
/// the next strongest if the strongest is the last. It must have a tenth of the
/// strongest's light. A ray is dropped if at most half of its cone has hits.
/// @param cone  scan that was cast along cone_rays(rays)
Scan receive(const RayTable& rays, const Scan& cone);

}  // namespace relidar::street
