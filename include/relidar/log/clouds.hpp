// SPDX-License-Identifier: Apache-2.0
// What readers of datasets have in common: points to scans, poses and boxes to tracks,
// and the check of what was read. A reader parses the dataset's files and fills a
// Sequence with these; docs/architecture.md section 3 has the recipe.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <relidar/log/points.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

/// Head angles at which a spinning LiDAR may fire: the ticks of its encoder, or even
/// steps.
struct HeadLattice {
    int n_ticks = 0;        ///< a sweep
    double zero_rad = 0.0;  ///< azimuth of tick 0

    double tick_rad() const;
    /// Tick nearest to a head azimuth, in [0, n_ticks).
    int tick(double head_azimuth_rad) const;
    /// Head azimuth of a tick in (-pi, pi].
    double azimuth_of(int tick) const;
};

/// One sweep: the lattice of a head and the ticks at which it fired, azimuth falling from
/// +pi.
struct Sweep {
    HeadLattice lattice;
    std::vector<int> firings;
};

/// A sweep of even steps, sensor.columns of them, where the heads of the points
/// (head_azimuth() of their beams) lie.
/// @param points  with rings
Sweep even_sweep(const Points& points, const SpinningSensor& sensor);

/// The scan of a spinning LiDAR, a cell for every ray fired, image order as RayTable has
/// it. Each point is put on the ray that took it: a return keeps its own direction, its
/// ray starts at the beam's origin. A firing without a point becomes a dropped ray of the
/// model. Of two first returns for one ray the second goes to a free cell beside it, else
/// the nearer is kept. Points beyond sensor.max_range_m only get rays that no other point
/// takes: drop_outside() removes them. A ray was fired when its point was measured, or
/// the nearest firing of that sweep; without times of points, when a head that faces
/// forward at time 0 gets there. A sweep with fewer firings than sensor.columns repeats
/// some of them, returns included, rather than invent drops: first where firings are
/// missing, then at its end.
/// @param points  with rings @throws UsageError where the points have no rings, or one of
/// no beam, or arrays of different lengths
Scan spinning_scan(const Points& points, const SpinningSensor& sensor, const Sweep& sweep);

/// The scan of a LiDAR without image order: a ray from the sensor's origin to each point,
/// in the given order, rows = 1. Which rays were dropped is not known. Further returns of
/// a ray follow its first one in the list. @throws as spinning_scan, but rings are not
/// needed
Scan unordered_scan(const Points& points);

/// Beams of a spinning LiDAR from points without rings: the elevations at which the
/// farther points gather, highest first, each beam starting at the sensor's centre. A few
/// scans are enough.
/// @return nothing where elevations do not gather in at least 4 narrow bands with nothing
/// between them, as those of a LiDAR that scans in another way, or whose beams start so
/// far from its centre that bands overlap (HDL-64E)
std::vector<Beam> find_beams(const std::vector<Points>& scans);

/// Gives every point the ring of the beam that passes nearest to it. @param beams  at
/// least one
void recover_rings(Points& points, const std::vector<Beam>& beams);

/// A spinning LiDAR as its points show it.
struct FittedSensor {
    SpinningSensor sensor;  ///< name and range limits are left to the reader
    /// [highest ring + 1] beam that took the points of a ring; kNoBeam: there was no
    /// point
    std::vector<std::uint16_t> beam_of_ring;
};
inline constexpr std::uint16_t kNoBeam = 0xFFFF;
/// Fits a spinning LiDAR to points whose rings are known, in whatever order the dataset
/// counts them. Elevations are medians over the farther half of a ring; columns follow
/// from the steps of the azimuth, offsets of beams within a step from its phase; period
/// and direction from the times, where there are any. Beams start at the sensor's centre;
/// a stagger by whole steps is not found.
/// @param scans  a few, with rings, whole sweeps @param period_s  of a sweep, for points
/// without times
/// @throws UsageError for points without rings, DataError where their azimuths have no
/// steps
FittedSensor fit_sensor(const std::vector<Points>& scans, double period_s);

/// Undoes motion compensation: points that a dataset has brought to the sensor at the
/// frame's reference time go back to the sensor as it was when each was measured. @param
/// points  with times @param world_from_sensor  of the LiDAR that measured them
void undo_compensation(Points& points, const PoseTrack& world_from_sensor, double time_s);

/// Rotation and translation as a pose. @param where  file and field, for the message
/// @throws DataError where the matrix is no rotation within 1e-3
Pose rigid_pose(const glm::dmat3& rotation, const glm::dvec3& translation, const std::string& where);

/// Appends a frame, its scan still empty, and the vehicle's pose at its time unless a
/// frame of another LiDAR at the same time has given it.
Frame& add_frame(Sequence& sequence, int index, double time_s, const Pose& world_from_vehicle, int lidar = 0);

/// Moves the world's origin to the vehicle in the middle pose: poses and boxes that were
/// read so far, and world_offset_m. Single precision is enough afterwards.
void recentre(Sequence& sequence);
/// The same to a given origin, in the present world.
void recentre(Sequence& sequence, glm::dvec3 origin_m);

/// A box as datasets list them, one moment at a time.
struct BoxLabel {
    std::string id;
    std::string category;
    glm::dvec3 size_m{0.0};  ///< length, width, height
    double time_s = 0.0;
    Pose world_from_box;  ///< of its centre
};
/// Labels joined to tracks by id, in the order of their first labels; size and category
/// are those of the first.
std::vector<BoxTrack> tracks_of(const std::vector<BoxLabel>& labels);

/// Whether a log is what sequence.hpp says: LiDARs and their numbers, ascending times
/// with a pose each, rays and returns that are finite, of unit direction and as many as
/// their tables say, boxes within reach of the vehicle. load_sequence() calls it for
/// every reader.
/// @throws DataError naming frame or box, field and value
void check_sequence(const Sequence& sequence);

/// Compares the times between frames with the usual one, their median. Adds a note to the
/// log for gaps, steps above 1 s and ten usual ones. Throws a DataError for a jump of its
/// clock, a step above 60 s and ten usual ones.
void check_gaps(Sequence& sequence);

}  // namespace relidar
