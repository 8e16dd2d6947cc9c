// SPDX-License-Identifier: Apache-2.0
// Decides how the points of a LiDAR become scans. The same plan serves files and bags:
// scan_plan.cpp decides, folder_scans.cpp reads, scan_notes.cpp tells the user.
#pragma once

#include <cmath>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <relidar/read/clouds.hpp>

#include "read/files/file_order.hpp"
#include "read/scans/firing_recovery.hpp"

namespace relidar {

/// Returns why LiDAR points cannot be scans of a spinning LiDAR, or an empty string. In a
/// spinning LiDAR, all points of a ring have nearly the same elevation. A sweep takes the
/// time of a full revolution, even if the field of view is limited.
/// @param scans  some scans, with rings
/// @param frame_interval_s  time between scans in seconds
std::string why_not_spinning(const std::vector<LidarPoints>& scans, const SpinningSensor& fitted_sensor,
                             double frame_interval_s);
/// Returns why points were probably removed from the scans, for example by a filter, or
/// an empty string. Signs are few rays with a return, or uneven azimuth steps in a ring.
/// Rays of removed points must not be treated as dropped rays.
/// @param scans  some scans with rings; the rings may have been estimated
std::string why_thinned(const std::vector<LidarPoints>& scans, const SpinningSensor& fitted_sensor);

}  // namespace relidar

namespace relidar::read {

/// What a reader knows about the scans of a LiDAR.
struct LidarScanLayout {
    bool has_beams = false;     ///< true if the beams of the LiDAR in the log are known
    bool spins = true;          ///< true if the LiDAR rotates; unknown beams can then be estimated
    bool lowest_first = false;  ///< true if ring 0 of the scans is the lowest beam
    /// Duration of a sweep, for points without times. 0: uses the time between frames.
    double sweep_duration_s = 0.0;
};

/// What a reader knows about the scans of a log.
struct ScanLayout {
    std::vector<LidarScanLayout> lidars = {};
    bool motion_compensated = false;
    std::string declared_by = "dataset";  ///< what says the conventions of the points
    bool is_deskew_declared = true;       ///< false: `motion_compensated` is only the default
    bool are_rings_set = false;           ///< true: `lowest_first` is set by the user
    bool is_deskew_set = false;           ///< true: by the user, so it is not guessed
    /// True if the user describes the LiDARs in sequence.json. Other points are an error.
    bool is_described = false;
};

/// Recovered firing times of the points of a LiDAR, and how it finds their rings.
struct FiringPlan {
    FiringRecovery recovery;
    /// Finds the rings of points without rings by their order in the file. If it is not
    /// set, `beams` find them by their elevations.
    std::optional<RingOrderDetector> ring_order = {};
    std::vector<Beam> beams = {};

    /// Sets the times of points and moves the points to where the sensor saw them at
    /// these times. Without rings, the points stay as they are.
    void restore(LidarPoints& points, double frame_time_s) const;
};
/// Searches the firing times of motion-compensated points that have none. Finds the rings
/// of points without rings first, because the search needs them.
/// @return nothing if the points show no rings, or no clear optimum
std::optional<FiringPlan> plan_firings(std::vector<CompensatedSweep> sweeps, const CompensatedSensor& sensor);

/// Interval of plausible times of points, relative to the time of the frame.
struct TimeLimits {
    double longest_offset_s = INFINITY;  ///< largest plausible distance from the median time
    std::optional<double> middle_s;      ///< median time of most scans; not set if they disagree
};
/// How the points of one LiDAR are read and converted to scans.
struct ScanPlan {
    TimeLimits time_limits;
    std::optional<FiringPlan> firings;  ///< recovered firing times of the points
    /// Firing times that points have if they are motion-compensated, which the log does
    /// not say. They are not used.
    std::optional<FiringPlan> unmarked_firings;
    /// Time after the frame to which the points were moved. Not set if they were not.
    std::optional<double> moved_to_s;
    bool undoes_motion = false;  ///< true: motion compensation is undone

    SpinningSensor sensor;   ///< beams of the rays; period 0 if each point becomes a ray
    bool has_beams = false;  ///< true: rays are beams and columns of the sensor; false: points
    bool is_fitted = false;  ///< true if the beams were fitted to the points
    bool has_rings = false, has_times = false;  ///< fields of the points, in all scans
    /// [ring numbers in files] beam; kNoBeam: points of this ring are ignored
    std::vector<std::uint16_t> beam_of_ring;
    /// Finds the rings of points without rings by their order in the file. If it is not
    /// set, the elevations show them.
    std::optional<RingOrderDetector> ring_order;
    std::string why_no_beams;       ///< why no beams fit the points of a LiDAR that may spin
    bool is_contradiction = false;  ///< true if the fit failed, although the LiDAR should spin
};

/// Duration of a sweep of most LiDARs of vehicles.
inline constexpr double kUsualPeriod_s = 0.1;

/// Returns the interval in which the times of the points of a scan must be.
/// @param sweep_s  duration of a sweep
TimeLimits find_time_limits(const std::vector<LidarPoints>& samples, double sweep_s);

/// Returns the median time between the frames of a LiDAR, or nothing for a single frame.
std::optional<double> median_step_s(const Log& log, int lidar);
/// Returns the duration of a revolution: the median time between frames, divided by the
/// number of revolutions if the log has only every n-th scan.
double estimate_sweep_s(const Log& log, int lidar);

/// Plans how points become rays. Estimates unknown beams from the points. Without beams,
/// each point becomes a ray of a sensor that does not rotate (period 0).
/// @param plan  with the sensor of the LiDAR as far as it is known
/// @param samples  points of some scans; may be empty
void plan_rays(ScanPlan& plan, const LidarScanLayout& layout, double sweep_s,
               std::vector<LidarPoints> samples);

/// Numbers of points of a frame, for notes.
struct PointCounts {
    std::size_t without_beam = 0;  ///< skipped, because the fitted sensor has no beam for their ring
    std::size_t late = 0;          ///< skipped, because their time is outside the sweep
    std::size_t first = 0;         ///< first returns
    std::size_t behind = 0;        ///< skipped, because their ray has a nearer point
};
/// Adds notes for the user about the plan of a LiDAR.
/// @param samples  points of some scans
void note_plan(Log& log, const ScanLayout& layout, int lidar, const ScanPlan& plan,
               const std::vector<LidarPoints>& samples);
/// Adds notes for the user about points that are skipped.
/// @param counts  [frames]
void note_skipped_points(Log& log, const ScanLayout& layout, const std::vector<PointCounts>& counts);

}  // namespace relidar::read
