// SPDX-License-Identifier: Apache-2.0
// What the synthetic street sends back to a beam that is a cone, and what a receiver of
// two returns makes of it. Private to dataset.
#pragma once

#include <relidar/log/sequence.hpp>

namespace relidar::street {

inline constexpr int kConeRays = 53;  ///< exact rays for each beam

/// kConeRays rays for each one, in a spiral that covers its cone evenly. @param rays
/// with a divergence
RayTable cone_rays(const RayTable& rays);

/// Two returns of each ray from what its cone met: parts that are connected by steps in
/// range below 0.5 m are one return, of their mean range weighted by light; the strongest
/// first, then the last, or the next strongest where the strongest is the last, if it has
/// a tenth of the strongest's light. A ray of which not more than half comes back is
/// dropped.
/// @param cone  cast along cone_rays(rays)
Scan receive(const RayTable& rays, const Scan& cone);

}  // namespace relidar::street
