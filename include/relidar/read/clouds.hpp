// SPDX-License-Identifier: Apache-2.0
// Functions that all dataset readers share. They convert points to scans, and poses and
// boxes to tracks, and check the result. A dataset reader parses the files of a dataset
// and fills a Log. docs/architecture.md section 3 explains how to add a reader.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include <relidar/log/log.hpp>
#include <relidar/read/points.hpp>

namespace relidar {

/// Azimuths at which a spinning LiDAR can fire: the ticks of its encoder, or equal steps
/// around the circle.
struct EncoderTickGrid {
    int n_ticks = 0;        ///< number of ticks in a sweep
    double zero_rad = 0.0;  ///< azimuth of tick 0

    /// Returns the angle between two consecutive ticks.
    double tick_step_rad() const;
    /// Returns the encoder tick nearest to an azimuth of the rotating head, in [0,
    /// n_ticks).
    int nearest_tick(double head_azimuth_rad) const;
    /// Returns the azimuth of the rotating head at an encoder tick, in (-pi, pi].
    double tick_azimuth_rad(int tick) const;
};

/// One sweep of a spinning LiDAR. `lattice` has the azimuths at which the LiDAR can fire,
/// `firings` the ticks at which it has fired. The azimuth decreases from +pi during the
/// sweep.
struct SweepFirings {
    EncoderTickGrid lattice;
    std::vector<int> firings;
};

/// Returns a sweep in which the LiDAR fires at `sensor.columns` equally spaced azimuths
/// of its rotating head. Chooses the first azimuth so that these azimuths match the head
/// azimuths at which the beams measured the points.
/// @param points  points with beam numbers (`LidarPoints::ring`)
SweepFirings fit_even_sweep(const LidarPoints& points, const SpinningSensor& sensor);

/// Builds the scan of a spinning LiDAR in the order of a range image, with one ray for
/// each beam and firing. A ray with a return keeps its measured direction and starts at
/// the origin of its beam. Without a point, it is a dropped ray with the direction of the
/// sensor model.
///
/// If two first returns belong to one ray, the second of them is moved to a free
/// neighbouring cell of the image. If no such cell is free, only the nearer point is
/// kept. A point beyond sensor.max_range_m gets a ray only if no other point uses this
/// ray. limit_ranges() removes such points later.
///
/// The firing time of a ray is the time of its point. A ray without a point gets the time
/// of the nearest firing in the sweep. For points without times, the firing time is
/// computed from a head that faces forward at time 0. If a sweep has fewer firings than
/// sensor.columns, some firings are repeated with their returns, because additional
/// dropped rays would be wrong. Firings next to gaps are repeated first, then firings at
/// the end of the sweep.
/// @param points  points with rings
/// @throws UsageError if the points have no rings, if a ring has no beam, or if the
/// arrays have different lengths
Scan spinning_scan(const LidarPoints& points, const SpinningSensor& sensor, const SweepFirings& firings);

/// Builds the scan of a LiDAR whose rays do not form an image (rows = 1). The scan has
/// one ray from the sensor origin to each point, in the order of the points. Rays without
/// a return are unknown and are not in the scan. The other returns of a ray must follow
/// its first return in `points`. Beam numbers are not needed.
/// @throws UsageError if the arrays have different lengths
Scan scan_of_points(const LidarPoints& points);

/// Estimates the beams of a spinning LiDAR from points without beam numbers. The
/// elevations of distant points form clusters, and each cluster is a beam. The highest
/// beam is first. All beams start at the centre of the sensor. A few scans are enough.
/// @return nothing if the elevations do not form at least 4 narrow, separate bands, as
/// for LiDARs that do not spin, or whose beams start far from the centre (HDL-64E)
std::vector<Beam> estimate_beams(const std::vector<LidarPoints>& scans);

/// Sets the ring of each point to the nearest beam.
/// @param beams  at least one beam
void assign_rings(LidarPoints& points, const std::vector<Beam>& beams);

/// Model of a spinning LiDAR that was fitted to its points.
struct FittedSensor {
    SpinningSensor sensor;  ///< Fitted sensor. The dataset reader must set its name and its range limits.
    /// [rings] beam that measured the points; kNoBeam for a ring without points
    std::vector<std::uint16_t> beam_of_ring;
};
inline constexpr std::uint16_t kNoBeam = 0xFFFF;
/// Fits a model of a spinning LiDAR to points with known rings, which the dataset may
/// number in any order. The elevation of a beam is the median over the farther half of
/// the points of its ring. The number of columns is computed from the azimuth steps
/// between points, and offsets of the beams within one step from the remainder of the
/// azimuths. Period and direction of rotation are computed from the times of the points,
/// if there are any. All beams start at the sensor's centre. Azimuth offsets of complete
/// steps cannot be detected.
/// @param scans  a few complete sweeps with rings
/// @param period_s  duration of a sweep, for points without times
/// @throws UsageError if the points have no rings
/// @throws DataError if the azimuths are not in steps
FittedSensor fit_spinning_sensor(const std::vector<LidarPoints>& scans, double period_s);

/// Reverts the motion compensation of a scan, in which all points are in the sensor frame
/// at time `compensated_time_s`. Converts each point to the sensor frame at its firing
/// time.
/// @param points  points with firing times
/// @param world_from_sensor  poses of the LiDAR that measured the points
void undo_deskew(LidarPoints& points, const PoseTrack& world_from_sensor, double compensated_time_s);

/// Returns the pose with this rotation and translation.
/// @param where  file and field, for the error message
/// @throws DataError if the matrix is not a rotation within 1e-3
Pose make_pose(const glm::dmat3& rotation, const glm::dvec3& translation, const std::string& where);
/// Returns the pose of a transform matrix.
/// @param matrix  [3 x 4] or [4 x 4] row-major; ignores the last row
Pose make_pose(std::span<const double> matrix, const std::string& where);

/// Appends a frame with an empty scan, and the vehicle's pose at this time unless a frame
/// of another LiDAR has added it.
Frame& add_frame(Log& log, int number, double time_s, const Pose& world_from_vehicle, int lidar = 0);

/// Moves the world origin to the vehicle at the middle pose of the log, so that
/// coordinates are small enough for single precision. Adjusts poses, boxes and
/// world_offset_m.
void centre_log(Log& log);
/// Moves the world origin to a given point, and adjusts the log in the same way.
/// @param new_origin_m  new origin, in the world frame before the move
void centre_log(Log& log, glm::dvec3 new_origin_m);

/// Box of an object at one time, as the labels of a dataset store it.
struct BoxLabel {
    std::string id;
    std::string category;
    glm::dvec3 size_m{0.0};  ///< length, width, height
    double time_s = 0.0;
    Pose world_from_box;  ///< pose of the centre of the box
};
/// Groups box labels with the same id into one track, in the order of the first labels.
/// The first label defines the size and category of the track.
std::vector<BoxTrack> build_tracks(const std::vector<BoxLabel>& labels);

}  // namespace relidar
