// SPDX-License-Identifier: Apache-2.0
// Assigns the points of a KITTI scan to the 64 beams of the LiDAR. Also fits the cone on
// which the points of each beam lie:
//   z = z0 + rho * tan(elevation),  rho = hypot(x, y)
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace relidar::kitti {

constexpr int kRings = 64;

/// The points of a scan in file order, and the beam of each point. Beam 0 is the highest.
struct RawScan {
    std::vector<glm::vec4> points;  ///< x, y, z (metres, sensor frame), reflectance
    std::vector<std::uint8_t> ring;
    int n_rings = 0;  ///< number of rings in the file, 64 in a complete scan
};

/// Cone that a beam draws when the head rotates.
struct Cone {
    double z0_m = 0.0;  ///< height at which the beam crosses the spin axis
    double tan_el = 0.0;
    std::size_t n = 0;  ///< number of points in the fit; 0: the cone was estimated from other beams
};
using Cones = std::array<Cone, kRings>;

/// Splits a scan into rings. The file stores one ring after another, and the azimuth of a
/// ring increases from the forward direction. So a new ring begins where the azimuth
/// changes from the 4th to the 1st quadrant. Ring numbers are limited to 63.
RawScan split_rings(std::vector<glm::vec4> points);

/// Fits the cone of every ring to several scans by least squares. Outliers are ignored.
/// @param where  description of the log for error messages
/// @throws DataError if no scan has 64 rings
Cones fit_cones(const std::vector<const RawScan*>& scans, const std::string& where);

/// Corrects wrong rings with the help of the fitted cones. The file order gives wrong
/// rings if a beam has no returns at all. It also gives a wrong ring for a last point
/// that was rounded to azimuth 0, which seems to start the next ring.
void correct_rings(RawScan& scan, const Cones& cones);

}  // namespace relidar::kitti
