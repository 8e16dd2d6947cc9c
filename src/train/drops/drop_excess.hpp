// SPDX-License-Identifier: Apache-2.0
// Tells the drops of the sensor from those of the scene. A surface returns less light if
// it is darker or farther away, whatever beam hits it. A beam that drops more rays at an
// azimuth than such surfaces explain is blocked there, for example by the vehicle.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <relidar/log/log.hpp>

namespace relidar {

/// A measured ray that hits a solid surface of the scene, or that training ignored.
struct CheckedRay {
    std::uint32_t bin;  ///< index in the table of drops
    bool is_dropped;
    bool is_ignored;           ///< is_blind_ray()
    bool is_met = true;        ///< The scene has a surface that may return it.
    float range_m, intensity;  ///< rendered
    float drop_logit;          ///< rendered drop logit minus hit logit
};

/// Returns for each bin the rate p at which the sensor drops rays that the scene returns.
/// A logistic regression of the drops in all bins gives the probability q with which the
/// scene drops a ray. A bin with n rays and d drops has the excess e = d - sum of q and
///   p = (e + 8 m) / (n - sum of q + 8),
/// where m = (sum of e) / (8 + sum of (n - sum of q)) over the bin and two neighbours on
/// each side. If p is below 0.5, or the excess of these five bins is not significant
/// (three sigma), another rule decides: p is the share of dropped rays if the bin has
/// ignored rays and the scene returns at least 5 % of those of the five bins, otherwise
/// it is 0.
/// @param bins  number of beams and of azimuth bins
RayDropTable find_drop_excess(const RayDropTable& bins, std::span<const CheckedRay> rays);

}  // namespace relidar
