// SPDX-License-Identifier: Apache-2.0
// Recovers the firing times of motion-compensated scans whose points have no times. The
// points of a beam are on a cone around the axis of the head:
//   z = z0 + slope * rho,  rho = hypot(x, y)
// Compensation moves the points off this cone. find_firings() searches for the turn of
// the head and the motion of the sensor that move all points back to their cones.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/log.hpp>
#include <relidar/read/points.hpp>

namespace relidar {
struct EncoderTickGrid;
}

namespace relidar::read {

/// The turn of a head in a sweep. Times are in turns after the time of the frame.
struct HeadTurn {
    bool clockwise = true;
    double seam_rad = kPi;      ///< azimuth of the head at the start and the end of the sweep
    double start_turns = -0.5;  ///< time of the start

    double end_turns() const { return start_turns + 1.0; }
    /// Returns the time at which the head has an azimuth, from the start to the end.
    double time_turns(double azimuth_rad) const;
};

/// Cone of the points of a beam: z = z0_m + slope * (distance from the axis)
struct RingCone {
    double z0_m = 0.0, slope = 0.0;
};

/// A motion-compensated sweep. Its points have rings, but no times.
struct CompensatedSweep {
    LidarPoints points;
    double time_s = 0.0;  ///< time of the frame
};

/// What is known about a LiDAR before the search.
struct CompensatedSensor {
    double period_s = 0.1;                            ///< duration of a sweep
    std::optional<PoseTrack> world_from_sensor = {};  ///< empty if the log has no poses
    int n_ticks = 0;              ///< steps of the head in a turn, multiples of which are fired; 0: unknown
    glm::dvec3 forward{1, 0, 0};  ///< driving direction in the sensor frame, for logs without poses
};

/// Steps of the head at which beams fire.
struct HeadTicks {
    int n = 0;                   ///< number in a turn; 0: unknown
    std::vector<double> left_m;  ///< [rings] distance by which the beam starts to the left of the axis
};

/// Turn of the head and beams of a LiDAR, found by find_firings().
struct FiringRecovery {
    CompensatedSensor sensor;
    HeadTurn turn;
    std::vector<RingCone> rings;  ///< [rings] a ring without points has slope NaN
    HeadTicks ticks;
    /// True if the poses of the log explain the compensation. Otherwise each sweep gets
    /// the motion that fits its points best.
    bool uses_poses = false;
    /// robust standard deviation of the elevations of a ring, restored and in the log
    double spread_rad = 0.0, compensated_spread_rad = 0.0;
    double other_seam_rad = 0.0;  ///< smallest spread with a clearly different seam
};

/// Searches the turn of the head. Some sweeps of a log are enough.
/// @return nothing if no turn is clearly better than points without motion, or if the
/// motion contradicts the poses of the log
std::optional<FiringRecovery> find_firings(const std::vector<CompensatedSweep>& sweeps,
                                           const CompensatedSensor& sensor);

/// Sets the times of points, and moves each point to the sensor frame at its time. Uses
/// the motion of the poses, or else fits the motion to the points.
/// @param points  points with the rings that `recovery` was made of
void restore_firings(LidarPoints& points, const FiringRecovery& recovery, double frame_time_s);

/// Sets the times of restored points to the times at which the head fired. Datasets
/// compensate with the azimuths of points, but a beam can look many degrees beside the
/// head. At the start of the sweep, its points then belong to the other end.
/// @param points  points with the indices of `beams` as rings
/// @param ticks   azimuths at which the head fires
void set_head_times(LidarPoints& points, const std::vector<Beam>& beams, const EncoderTickGrid& ticks,
                    const FiringRecovery& recovery);

/// Tests whether points with times were moved to a common time, and undoes this with the
/// poses of the log for each possible time: that of the frame, the first and the last
/// point. At the right one, the elevations of a ring are nearly equal.
/// @param sweeps  some sweeps with rings and times
/// @return this time in seconds after the frame. Nothing if the points were not moved.
std::optional<double> find_moved_time(const std::vector<CompensatedSweep>& sweeps,
                                      const PoseTrack& world_from_sensor);
/// Moves points with times back to them from the time `moved_to_s` after the frame.
void undo_deskew_to(LidarPoints& points, const PoseTrack& world_from_sensor, double frame_time_s,
                    double moved_to_s);

/// Returns a note for the user: what was found and how certain it is.
std::string describe_recovery(const FiringRecovery& recovery);

}  // namespace relidar::read
