// SPDX-License-Identifier: Apache-2.0
// Estimates the firing times and head angles of an HDL-64E. All 64 beams fire together,
// about 2152 times per revolution. An encoder with ticks of 0.09 degrees measures the
// head angle of each firing. So the azimuth of a point of beam k is
//   azimuth = head + offset_k + asin(left_k / rho),   head = tick * n + constant
// with the same tick size for all beams. The offsets offset_k and left_k of each beam are
// fitted to the log. They give the firings of each sweep. If a beam has no point at a
// firing, the ray is a dropped ray (without a return).
#pragma once

#include <array>
#include <vector>

#include <relidar/log/clouds.hpp>

#include "log/readers/kitti/hdl64_rings.hpp"

namespace relidar::kitti {

/// Regular grid of azimuths at which the rotating head of a LiDAR can fire. For each
/// beam: its azimuth relative to the head, and its distance from the spin axis.
struct BeamFiringGrid {
    EncoderTickGrid head;
    /// True if the points do not fit the ticks of the rotary encoder. The ticks of `head`
    /// are then estimated equal steps, and the LiDAR is assumed to fire at every tick.
    bool every_tick = false;
    /// azimuth of each beam relative to the head; the mean of all beams is 0
    std::array<double, kRings> offset_rad{};
    /// distance of each beam from the spin axis, positive to the left
    std::array<double, kRings> left_m{};

    /// Returns the beams of the sensor. Uses the azimuth and lateral offsets of this
    /// struct, and the elevations and heights of `cones`. Each cone was fitted to the
    /// points of one rotating beam.
    std::vector<Beam> make_beams_with_fitted_elevations(const BeamCones& cones) const;
};

/// Estimates the azimuth grid at which the head fires, and the offsets of all beams, from
/// a few scans. If the azimuths fit no grid, returns equal steps and zero offsets.
BeamFiringGrid fit_beam_firing_grid(const std::vector<const ScanWithRings*>& scans);

/// Returns the azimuth steps at which the head fired in a sweep, in order of time. The
/// head rotates clockwise, starting near azimuth +pi.
std::vector<int> find_fired_encoder_ticks(const ScanWithRings& scan, const BeamFiringGrid& firing_grid);

}  // namespace relidar::kitti
