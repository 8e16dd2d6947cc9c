// SPDX-License-Identifier: Apache-2.0
// Tells the drops of the sensor from those of the scene. A surface returns less light if
// it is darker or farther away, whatever beam hits it. A beam that drops more rays at an
// azimuth than such surfaces explain is blocked there, for example by the vehicle.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <relidar/log/sequence.hpp>

namespace relidar {

/// A measured ray that hits a solid surface of the trained scene.
struct SolidRay {
    std::uint32_t bin;  ///< index in the table of drops
    bool is_dropped;
    float range_m, intensity;  ///< rendered
    float drop_logit;          ///< rendered drop logit minus hit logit
};

/// Returns for each bin the rate p at which the sensor drops rays that the scene returns.
/// A logistic regression of the drops in all bins gives the probability q with which the
/// scene drops a ray. A bin with n rays and d drops has the excess e = d - sum of q and
///   p = (e + 8 m) / (n - sum of q + 8),
/// where m = (sum of e) / (8 + sum of (n - sum of q)) over the bin and two neighbours on
/// each side. p = 0 below 0.5, or if the excess of these five bins is not significant
/// (three sigma).
/// @param bins  number of beams and of azimuth bins
RayDropTable find_drop_excess(const RayDropTable& bins, std::span<const SolidRay> rays);

}  // namespace relidar
