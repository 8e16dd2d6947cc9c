// SPDX-License-Identifier: Apache-2.0
// Assigns the points of a KITTI scan to the 64 beams of the LiDAR. Also fits a cone to
// the points of each beam:
//   z = z0 + rho * tan(elevation),  rho = hypot(x, y)
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/classes.hpp>

#include "read/scans/robust_line.hpp"

namespace relidar::kitti {

constexpr int kRings = 64;

struct RingScan {
    std::vector<glm::vec4> points;  ///< x, y, z in metres in the sensor frame, and reflectance
    std::vector<std::uint8_t> ring;
    int n_rings = 0;                    ///< number of rings in the file; 64 in a complete scan
    std::vector<SurfaceClass> classes;  ///< [points] classes; empty if the points have no labels
    /// [points] times after the frame; empty if they follow from the azimuths
    std::vector<float> time_offset_s = {};
};

/// Cones of the beams: z = at_zero + slope * distance from the spin axis. The number n of
/// points is 0 if the cone was estimated from other beams.
using BeamCones = std::array<read::RobustLine, kRings>;

/// Splits the points of a file into rings. The file stores ring after ring, each starting
/// at the forward direction. A new ring begins where the azimuth changes from the 4th to
/// the 1st quadrant. Ring numbers are limited to 255.
RingScan split_rings(std::vector<glm::vec4> points);

/// Fits a cone to each ring by robust least squares. Uses all complete scans (64 rings).
/// @param where  name of the log, for error messages
/// @throws DataError if no scan is complete, or too few rings have enough returns
BeamCones fit_ring_cones(const std::vector<const RingScan*>& scans, const std::string& where);

/// Corrects the ring numbers of points that are nearer to the cone of another ring.
/// Counting rings in file order fails if a beam has no returns. It also fails if the last
/// point of a ring was rounded to azimuth 0, where the next ring starts.
void correct_rings(RingScan& scan, const BeamCones& cones);

}  // namespace relidar::kitti
