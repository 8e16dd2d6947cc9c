// SPDX-License-Identifier: Apache-2.0
// Finds the rings of points that a file stores ring by ring. Along the file, the azimuth
// then turns once per ring. This works even if the elevations of the rings overlap, as
// those of an HDL-64E do, because its beams start far from the sensor's centre.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/log/points.hpp>

namespace relidar::folder {

/// Order of the points in the files of a LiDAR.
class FileOrder {
public:
    /// Finds out whether some scans are stored ring by ring.
    explicit FileOrder(const std::vector<Points>& scans);
    /// True: the scans are stored ring by ring, with at least 4 rings.
    bool shows_rings() const { return !elevation_rad_.empty(); }
    std::size_t n_rings() const { return elevation_rad_.size(); }
    /// Sets the ring of each point. Ring 0 is the first one in the files. If a scan has
    /// fewer rings, the ring with the nearest elevation is used.
    void set_rings(Points& points) const;

private:
    double first_azimuth_rad_ = 0.0;     ///< azimuth at which the rings begin
    double turning_ = 1.0;               ///< 1: the azimuth increases along a ring; -1: it decreases
    std::vector<double> elevation_rad_;  ///< [rings] median elevation of the far points
};

}  // namespace relidar::folder
