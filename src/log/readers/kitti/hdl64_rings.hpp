// SPDX-License-Identifier: Apache-2.0
// Assignment of the points of a KITTI scan to the 64 beams, and the cone that each beam
// sweeps:
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
    int n_rings = 0;  ///< number of rings in the file, 64 in a complete scan
};

/// Cone of one beam.
struct Cone {
    double z0_m = 0.0;  ///< height at which the beam crosses the spin axis
    double tan_el = 0.0;
    std::size_t n = 0;  ///< number of points of the fit; 0: interpolated from neighbours
};
using Cones = std::array<Cone, kRings>;

/// Splits a scan into rings. The points are stored ring by ring, with azimuth rising from
/// forward. So a ring ends when the azimuth passes from the 4th into the 1st quadrant.
/// Ring numbers are at most 63.
RawScan split_rings(std::vector<glm::vec4> points);

/// Fits the cone of every ring to several scans by least squares without outliers.
/// @param where  description of the log for error messages
/// @throws DataError if no scan has 64 rings
Cones fit_cones(const std::vector<const RawScan*>& scans, const std::string& where);

/// Corrects two cases in which the file order gives wrong rings: a scan in which a beam
/// has no returns, and points rounded to azimuth 0. Such a point ends its ring but seems
/// to start the next one.
void correct_rings(RawScan& scan, const Cones& cones);

}  // namespace relidar::kitti
