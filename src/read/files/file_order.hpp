// SPDX-License-Identifier: Apache-2.0
// Finds the ring of each point, if a file stores the points ring by ring. In such a file,
// the azimuth makes one turn per ring. This also works for an HDL-64E, whose rings
// overlap in elevation because its beams start far from the centre of the sensor.
#pragma once

#include <vector>

#include <relidar/read/points.hpp>

namespace relidar::read {

class RingOrderDetector {
public:
    /// Tests whether the files store their points one ring after another. If so, finds
    /// the azimuth at which rings begin, and the elevation of each ring.
    /// @param scans  some scans of the LiDAR
    explicit RingOrderDetector(const std::vector<LidarPoints>& scans);
    /// Returns true if the constructor found at least 4 rings that are stored one after
    /// another.
    bool is_ring_by_ring() const { return !elevation_rad_.empty(); }
    std::size_t n_rings() const { return elevation_rad_.size(); }
    /// Sets the ring of each point. Ring 0 is the first ring in the files. In a scan with
    /// fewer rings, each ring gets the number of the ring with the nearest elevation.
    void number_rings(LidarPoints& points) const;

private:
    double first_azimuth_rad_ = 0.0;     ///< azimuth at which each ring begins
    double rotation_sign_ = 1.0;         ///< 1 if the azimuth increases along a ring, -1 if it decreases
    std::vector<double> elevation_rad_;  ///< [rings] median elevation of the farther points of each ring
};

}  // namespace relidar::read
