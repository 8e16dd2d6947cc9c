// SPDX-License-Identifier: Apache-2.0
// Functions that all dataset readers share. They convert points to scans, poses and boxes
// to tracks, and check the result. A reader parses the files of a dataset and fills a
// Sequence; docs/architecture.md section 3 explains how to add one.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <relidar/log/points.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

/// Azimuths of the head at which a spinning LiDAR may fire: the ticks of its encoder, or
/// equal steps.
struct HeadLattice {
    int n_ticks = 0;        ///< number of ticks in a sweep
    double zero_rad = 0.0;  ///< azimuth of tick 0

    double tick_rad() const;
    /// Returns the tick nearest to an azimuth of the head, in [0, n_ticks).
    int tick(double head_azimuth_rad) const;
    /// Returns the azimuth of the head at a tick, in (-pi, pi].
    double azimuth_of(int tick) const;
};

/// One sweep: the lattice of the head azimuths, and the ticks at which the head fired.
/// The azimuth decreases from +pi.
struct Sweep {
    HeadLattice lattice;
    std::vector<int> firings;
};

/// Fits a sweep with sensor.columns equal steps to the head azimuths of the points, which
/// head_azimuth() computes from their beams.
/// @param points  points with rings
Sweep even_sweep(const Points& points, const SpinningSensor& sensor);

/// Builds the scan of a spinning LiDAR, with one cell for each fired ray, in the image
/// order of RayTable. Each point is assigned to the ray that measured it. A returned ray
/// keeps its measured direction, and starts at the origin of its beam. A firing without a
/// point becomes a dropped ray with the direction of the sensor model.
///
/// If two first returns belong to one ray, the second is moved to a free neighbouring
/// cell. If no such cell is free, only the nearer point is kept. A point beyond
/// sensor.max_range_m gets a ray only if no other point uses this ray; drop_outside()
/// removes such points later.
///
/// The firing time of a ray is the time of its point, or of the nearest firing in that
/// sweep. For points without times, it is the time at which a head that faces forward at
/// time 0 reaches the azimuth. A sweep with fewer firings than sensor.columns repeats
/// some firings with their returns, because additional dropped rays would be wrong. It
/// repeats firings first at gaps, then at the end of the sweep.
/// @param points  points with rings
/// @throws UsageError if the points have no rings, if a ring has no beam, or if the
/// arrays have different lengths
Scan spinning_scan(const Points& points, const SpinningSensor& sensor, const Sweep& sweep);

/// Builds the scan of a LiDAR without image order: one ray from the sensor origin to each
/// point, in the given order, rows = 1. Dropped rays are unknown. The further returns of
/// a ray follow its first return in the list. Rings are not needed.
/// @throws UsageError as spinning_scan()
Scan unordered_scan(const Points& points);

/// Estimates the beams of a spinning LiDAR from points without rings. Beams are the
/// elevations around which distant points cluster, highest first. Each beam starts at the
/// sensor's centre. A few scans are enough.
/// @return nothing if the elevations do not form at least 4 narrow, separate bands. This
/// is so for LiDARs that do not spin, and for LiDARs whose beams start so far from the
/// centre that the bands overlap (HDL-64E).
std::vector<Beam> find_beams(const std::vector<Points>& scans);

/// Sets the ring of each point to the beam that passes nearest to the point.
/// @param beams  at least one beam
void recover_rings(Points& points, const std::vector<Beam>& beams);

/// Model of a spinning LiDAR that was fitted to its points.
struct FittedSensor {
    SpinningSensor sensor;  ///< fitted sensor; the reader must set its name and range limits
    /// [highest ring + 1] index of the beam that measured the points of a ring; kNoBeam
    /// if the ring has no points
    std::vector<std::uint16_t> beam_of_ring;
};
inline constexpr std::uint16_t kNoBeam = 0xFFFF;
/// Fits a spinning LiDAR to points with known rings, which the dataset may number in any
/// order. The elevation of a beam is the median over the farther half of the points of
/// its ring. The number of columns follows from the azimuth steps, and the azimuth
/// offsets of beams within a step from the phase of the azimuths. Period and direction
/// follow from the times of the points, if there are any. All beams start at the sensor's
/// centre. Azimuth offsets of complete steps cannot be detected.
/// @param scans  a few complete sweeps with rings
/// @param period_s  duration of a sweep, for points without times
/// @throws UsageError if the points have no rings
/// @throws DataError if the azimuths are not in steps
FittedSensor fit_sensor(const std::vector<Points>& scans, double period_s);

/// Reverts motion compensation. Converts points from the sensor frame at the reference
/// time of the frame to the sensor frame at the time of each point.
/// @param points  points with times
/// @param world_from_sensor  poses of the LiDAR that measured the points
void undo_compensation(Points& points, const PoseTrack& world_from_sensor, double time_s);

/// Returns a rotation and a translation as a pose.
/// @param where  file and field, for the error message
/// @throws DataError if the matrix is not a rotation within 1e-3
Pose rigid_pose(const glm::dmat3& rotation, const glm::dvec3& translation, const std::string& where);

/// Appends a frame with an empty scan. Also appends the pose of the vehicle at its time,
/// unless a frame of another LiDAR at the same time already added it.
Frame& add_frame(Sequence& sequence, int index, double time_s, const Pose& world_from_vehicle, int lidar = 0);

/// Moves the world origin to the vehicle at the middle pose. Changes the poses and boxes
/// that were read so far, and world_offset_m. Single precision is then sufficient.
void recentre(Sequence& sequence);
/// Moves the world origin to a point.
/// @param origin_m  new origin in the present world frame
void recentre(Sequence& sequence, glm::dvec3 origin_m);

/// Box of an object at one time, as datasets list it.
struct BoxLabel {
    std::string id;
    std::string category;
    glm::dvec3 size_m{0.0};  ///< length, width, height
    double time_s = 0.0;
    Pose world_from_box;  ///< pose of the centre of the box
};
/// Joins labels with the same id to tracks, in the order of their first labels. The first
/// label of a track sets its size and category.
std::vector<BoxTrack> tracks_of(const std::vector<BoxLabel>& labels);

/// Checks that a log meets the requirements of sequence.hpp:
/// - The LiDAR indices are valid, and each time has a pose; the times ascend.
/// - Rays and returns are finite, directions are unit vectors, and all arrays of a scan
///   have the length of its ray table.
/// - Boxes are within reach of the vehicle. load_sequence() calls this function for every
///   reader.
/// @throws DataError naming the frame or box, the field and the value
void check_sequence(const Sequence& sequence);

/// Compares the time steps between frames with their median. Adds a note to the log for
/// each gap, which is a step above 1 s and above ten medians.
/// @throws DataError for a jump of the clock, which is a step above 60 s and above ten
/// medians
void check_gaps(Sequence& sequence);

}  // namespace relidar
