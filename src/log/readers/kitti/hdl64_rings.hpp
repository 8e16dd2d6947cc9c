// SPDX-License-Identifier: Apache-2.0
// Which of the 64 beams took each point of a KITTI scan, and the cone every beam sweeps:
//   z = z0 + rho * tan(elevation),  rho = hypot(x, y)
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace relidar::kitti {

constexpr int kRings = 64;

/// A scan in file order and the beam of each point, 0 = highest.
struct RawScan {
    std::vector<glm::vec4> points;  ///< x, y, z (metres, sensor frame), reflectance
    std::vector<std::uint8_t> ring;
    int n_rings = 0;  ///< runs of points found in the file, 64 in a whole scan
};

/// Cone of one beam.
struct Cone {
    double z0_m = 0.0;  ///< height at which the beam crosses the spin axis
    double tan_el = 0.0;
    std::size_t n = 0;  ///< points it was fitted to; 0 = filled in from its neighbours
};
using Cones = std::array<Cone, kRings>;

/// Splits a scan into rings: points are stored ring by ring, azimuth rising from forward,
/// so a ring ends where the azimuth passes from the 4th into the 1st quadrant. Counted to
/// 63 at most.
RawScan split_rings(std::vector<glm::vec4> points);

/// Least squares of every ring over several scans, outliers trimmed. @param where for
/// messages
/// @throws DataError where no scan has 64 rings
Cones fit_cones(const std::vector<const RawScan*>& scans, const std::string& where);

/// Puts right what file order cannot tell: a scan in which a beam returned nothing, and
/// points rounded to azimuth 0, which end their ring and yet seem to start the next one.
void correct_rings(RawScan& scan, const Cones& cones);

}  // namespace relidar::kitti
