// SPDX-License-Identifier: Apache-2.0
// Assigns the points of a KITTI scan to the 64 beams of the LiDAR. Also fits a cone to
// the points of each beam:
//   z = z0 + rho * tan(elevation),  rho = hypot(x, y)
#pragma once

#include <array>
#include <string>
#include <vector>

#include <relidar/read/points.hpp>

#include "read/scans/firing_recovery.hpp"

namespace relidar::kitti {

constexpr int kRings = 64;

struct RingScan {
    /// with rings; times are empty if they follow from the azimuths
    LidarPoints points;
    int n_rings = 0;  ///< number of rings in the file

    /// Returns true if the file has the rings of all beams. A stray point can look like
    /// the start of a 65th ring.
    bool is_complete() const { return n_rings == kRings || n_rings == kRings + 1; }
};

using BeamCones = std::array<read::RingCone, kRings>;

/// Splits the points of a file into rings. The file stores ring after ring, each starting
/// at the forward direction. A new ring begins where the azimuth changes from the 4th to
/// the 1st quadrant. Ring numbers are limited to 255.
RingScan split_rings(LidarPoints points);

/// Fits a cone to each ring by robust least squares. Uses all complete scans.
/// @param where  name of the log, for error messages
/// @throws DataError if no scan is complete, or too few rings have enough returns
BeamCones fit_ring_cones(const std::vector<const RingScan*>& scans, const std::string& where);

/// Corrects two mistakes of split_rings(). A beam without returns, or a stray point,
/// makes the numbers of all later rings wrong. And the last point of a ring, if it is
/// rounded to azimuth 0 where rings start, was counted for the next ring.
void correct_rings(RingScan& scan, const BeamCones& cones);

}  // namespace relidar::kitti
