// SPDX-License-Identifier: Apache-2.0
// What a LiDAR log is: scans with their rays, sensor poses in time, tracked boxes, and
// which frames are held out.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <relidar/base/math.hpp>
#include <relidar/log/sensor.hpp>

namespace relidar {

/// Where a time lies in a track: between entries `left` and `left + 1`, at fraction s;
/// outside 0..1 beyond its ends.
struct TrackPlace {
    std::size_t left = 0;
    double s = 0.0;  ///< 0 where the track has one entry only
};

/// Poses at ascending times.
struct PoseTrack {
    std::vector<double> time_s;
    std::vector<Pose> pose;

    /// Interpolated pose (slerp, lerp). Outside the first and last time the end segment's
    /// velocity continues.
    /// @throws DataError where the track is empty
    Pose at(double t_s) const;
    /// Of something that rides along: as moved_track(*this, mounted).at(t_s).
    Pose at(double t_s, const Pose& mounted) const;
    /// Between which poses at(t_s) interpolates. @throws DataError where the track is
    /// empty
    TrackPlace place(double t_s) const;
    bool covers(double t_s) const { return !time_s.empty() && t_s >= time_s.front() && t_s <= time_s.back(); }
};

/// The second return of each ray of a scan, or the third, ...
struct SecondReturn {
    std::vector<float> range_m;    ///< [n] along the ray from its origin; 0 = none
    std::vector<float> intensity;  ///< [n] 0..1; 0 where there is none
};

/// One measured (or simulated) sweep: its rays and what came back along each.
struct Scan {
    RayTable rays;               ///< a returned ray carries its own direction and origin
    ScanArray<float> range_m;    ///< [n] of the strongest return, along the ray from its origin; 0 = dropped
    ScanArray<float> intensity;  ///< [n] 0..1; 0 where dropped
    /// second, third ... return of the rays, none of a dropped one
    std::vector<SecondReturn> second_returns = {};

    /// End point of a ray. @return [3] metres, sensor frame at the ray's firing time
    glm::vec3 point(std::size_t ray) const { return rays.origin[ray] + range_m[ray] * rays.direction[ray]; }
    std::size_t count_returns() const;
};

/// Drops the rays of a scan whose range lies outside the limits, and their second returns
/// that do.
void drop_outside(Scan& scan, const RangeLimits& limits);

/// Where a head pointed and how long after the frame's time when a sweep began.
struct SweepStart {
    double azimuth_rad = 0.0;  ///< 0 for a LiDAR that does not spin
    double time_s = 0.0;
};

/// Where a sweep of these rays began, by their own times. Nothing where it began
/// backward, half a sweep before time 0, as one that faces forward at time 0; where the
/// LiDAR does not spin, or times and azimuths do not go together.
std::optional<SweepStart> find_start(const RayTable& rays, const SpinningSensor& sensor);

/// One sweep of one LiDAR of the log.
struct Frame {
    int index = 0;        ///< the dataset's own frame number; LiDARs that sweep together share it
    double time_s = 0.0;  ///< reference time: the head faces forward, but for a sweep with a `start`
    Scan scan;
    int lidar = 0;                         ///< in Sequence::lidars
    std::optional<SweepStart> start = {};  ///< see find_start(); load_sequence() looks for it
    /// [columns] see find_azimuth_shift(), likewise; empty: nominal
    std::vector<float> azimuth_shift_rad = {};
};

/// All of a frame but its scan.
inline Frame without_scan(const Frame& frame) {
    return {frame.index, frame.time_s, {}, frame.lidar, frame.start, frame.azimuth_shift_rad};
}

/// Which LiDAR of a log sweeps, when, and where its sweep begins.
struct SweepMoment {
    double time_s = 0.0;  ///< reference time of the sweep
    int lidar = 0;        ///< in Sequence::lidars
    std::optional<SweepStart> start = {};
};
/// Of a frame.
inline SweepMoment moment_of(const Frame& frame) { return {frame.time_s, frame.lidar, frame.start}; }

struct Lidar;
/// The same for any LiDAR. Of one that sweeps a window or draws a rosette: nothing where
/// the frame's time is in the middle of the scan, or where its pattern is not known.
std::optional<SweepStart> find_start(const RayTable& rays, const Lidar& lidar);

/// How much the ranges of a sensor scatter, by range and incidence.
struct RangeNoise {
    std::vector<double> range_m, cosine;  ///< upper ends of the bins, ascending; none: no noise is known
    std::vector<double> sigma_m;  ///< [ranges*cosines] standard deviations along the ray, a row a range

    /// Of the bin that holds range and cosine of the angle of incidence, or of the
    /// nearest; 0 where no noise is known.
    double at(double at_m, double at_cosine) const;
};

/// One LiDAR of a log.
struct Lidar {
    std::string name;  ///< the dataset's own, unique in the log; empty where there is one LiDAR alone
    /// nominal: for rays of frames without a scan of their own. No beams, period 0: it
    /// does not spin
    SpinningSensor sensor;
    /// where it is mounted; identity where the log has one: the vehicle's frame is then
    /// the sensor's
    Pose vehicle_from_sensor;
    /// nominal, of one that does not spin; not given: it spins, or is known by its scans
    /// alone
    std::optional<SensorPattern> pattern = {};
    RangeNoise range_noise = {};  ///< none unless measured

    /// Time of one sweep; 0 where it is not known.
    double period_s() const { return pattern ? period_of(*pattern) : sensor.period_s; }
};

/// Sets the nominal sensor of a LiDAR.
void set_sensor(Lidar& lidar, const SensorModel& sensor);
/// The nominal sensor of a LiDAR. One that is known by its scans alone has no beams.
SensorModel sensor_of(const Lidar& lidar);

/// Rays of a LiDAR's scan at a time, for frames without one of their own: none for one
/// that is known by its scans alone.
RayTable nominal_rays(const Lidar& lidar, double time_s);

/// How far to the left of its nominal azimuth the head of a spinning LiDAR pointed at
/// each firing of one sweep: the median over the returned rays of the firing, all beams
/// together, so that it does not say which of them were dropped. Firings that return less
/// than three rays lie between their neighbours. The rays of KITTI's HDL-64E are off by
/// up to three columns, with it by 0.01 of one.
/// @param nominal  nominal_rays() of the LiDAR @return [columns] radians, by firing
/// (column_shift()); empty where the scan is not in the order of the nominal rays, its
/// beams do not turn together, or it is where it nominally is
std::vector<float> find_azimuth_shift(const Scan& scan, const SpinningSensor& sensor,
                                      const RayTable& nominal);
/// Rays of a sensor's sweep where its head pointed: turned about the z axis, firing by
/// firing.
/// @param shift_rad  see find_azimuth_shift(); empty: nothing is turned
RayTable shifted_azimuths(RayTable rays, const SpinningSensor& sensor, const std::vector<float>& shift_rad);

/// Category of boxes that no dataset labelled (discover_tracks() in
/// relidar/scene/scene.hpp).
inline constexpr const char* kDiscoveredCategory = "Discovered";
/// moving boxes are grown by this where their points are left out: labels fit loosely
inline constexpr double kMoverMargin_m = 0.2;

/// One tracked box. The box frame has x along the length, y along the width, z up, origin
/// at the centre.
struct BoxTrack {
    std::string id;            ///< unique in the sequence
    std::string category;      ///< the dataset's own class name, or kDiscoveredCategory
    glm::dvec3 size_m{0.0};    ///< length, width, height
    PoseTrack world_from_box;  ///< at the times of the frames in which the box was labelled or discovered
    /// of a discovered box: what kind of thing its size was filled up for, as one side
    /// alone was seen
    std::string size_guess = {};
    /// poses of a labelled box before its first and after its last label:
    /// discover_tracks()
    std::size_t n_before = 0, n_after = 0;

    /// Whether the thing moves as far as labels and poses can tell, however often it was
    /// labelled. Its positions, averaged over a second (half of a shorter track) since
    /// labels jitter (by 9 cm on KITTI), come farther than half its longer side and 0.2
    /// m, or than 2 m, from the first, or go faster than 0.5 m/s, and 0.2 m, from one
    /// average to the next: a log's poses drift while a parked car is seen.
    bool moves() const;
    /// Whether the box was observed at a time, or half a mean step beside it: a sweep
    /// takes that long to either side of its label.
    bool present(double t_s) const;
    /// The same box as the dataset labelled it, without n_before and n_after poses at its
    /// ends.
    BoxTrack labelled_part() const;
    /// Whether a world point lies in the box, grown by margin_m, at a time.
    bool holds(const glm::dvec3& point_m, double t_s, double margin_m) const;
};

/// How the intensities of a log's beams fall alike with range and incidence:
///   measured by the mean beam = albedo * at_range(range) * at_cosine(cos),   1 at 10 m and square incidence
struct IntensityResponse {
    std::vector<double> range_m;  ///< knots, ascending; none: 1 at every range
    std::vector<double> factor;   ///< [knots], linear between them
    double incidence = 0.0;       ///< 0: as bright from every side, 1: Lambert's cosine

    double at_range(double at_m) const;  ///< the first and last factor beyond the knots
    /// Of the angle between ray and normal.
    double at_cosine(double cosine) const { return 1.0 - incidence * (1.0 - cosine); }
};

/// A LiDAR log, recentred: the world origin is the vehicle's position in the middle
/// frame.
struct Sequence {
    std::string name;
    std::string source;                                 ///< path it was read from
    std::vector<Lidar> lidars = std::vector<Lidar>(1);  ///< at least one
    std::vector<Frame> frames;                          ///< of all LiDARs, ascending time
    PoseTrack world_from_vehicle;                       ///< one entry for each time at which there are frames
    std::vector<BoxTrack> boxes;
    glm::dvec3 world_offset_m{0.0};        ///< add to relidar's world to get the dataset's world
    IntensityResponse intensity_response;  ///< of all LiDARs on these surfaces; 1 unless estimated
    std::string conventions;               ///< one line a human reads: frames, units, time reference
    std::vector<std::string> notes;        ///< what the log lacks, as it was read: a line each
    /// indices of the frames that published results on this part hold out, see
    /// split_frames()
    std::vector<int> test_frames = {};
    bool has_poses = true;        ///< false: identity, for a registration of the scans to find
    bool rolling_shutter = true;  ///< rays were fired at their own times (scans are not motion-compensated)

    const Lidar& lidar_of(const Frame& frame) const { return lidars[std::size_t(frame.lidar)]; }
    /// Entry of world_from_vehicle at the time of a frame. @throws DataError where there
    /// is none
    std::size_t pose_of(const Frame& frame) const;
    /// Poses of a LiDAR: those of the vehicle, at the same times, with its mounting.
    PoseTrack world_from_sensor(int lidar) const;
    /// Beams of all LiDARs.
    std::size_t count_beams() const;
    /// Number of a beam where those of all LiDARs are counted through, in the order of
    /// `lidars`; nothing where the LiDAR has no such beam.
    std::optional<std::uint16_t> beam_number(int lidar, std::uint16_t channel) const;
};

/// The box of an id; null where there is none, and for the empty id, which is the
/// background's.
const BoxTrack* find_box(const Sequence& sequence, const std::string& id);

/// All of a log but its frames.
Sequence without_frames(const Sequence& sequence);

/// Position of a LiDAR in Sequence::lidars, by its name; the first for an empty one.
/// @throws UsageError for a name that none has
int find_lidar(const Sequence& sequence, const std::string& name);

/// Poses of something that rides along. @param sensor_from_moved in the frame of what
/// `track` has the poses of
PoseTrack moved_track(PoseTrack track, const Pose& sensor_from_moved);
/// The same motion with more poses where it turns: what moved_track() mounts on it goes
/// round bends with it, not along chords.
PoseTrack with_fine_turns(const PoseTrack& track);
/// The same poses in a world whose origin lies elsewhere. @param by_m  what is added to
/// every place: Sequence::world_offset_m from relidar's world to the dataset's, minus it
/// back
PoseTrack shifted_track(PoseTrack track, const glm::dvec3& by_m);

/// Gives the vehicle other poses at the same times. Boxes go along: they were labelled on
/// the scans, so each stays where it was as seen from the vehicle at its label's time.
void set_vehicle_poses(Sequence& sequence, PoseTrack world_from_vehicle);

/// A ray in the world at the moment it was fired.
struct WorldRay {
    glm::dvec3 origin_m;
    glm::dvec3 direction;
};

/// Where a ray of a frame starts and points, the sensor pose interpolated to the ray's
/// own firing time where the sequence has a rolling shutter.
/// @param time_s  reference time of the sweep @param ray  index into rays
WorldRay world_ray(const PoseTrack& world_from_sensor, double time_s, const RayTable& rays, std::size_t ray,
                   bool rolling_shutter);

/// When the head of a LiDAR faces a point: the moment of the sweep at which a static or
/// moving thing there is seen. A window's mirrors face its column; of a rosette, which
/// faces everything again and again, and of a table of rays, it is the middle of the
/// scan.
/// @param point_m [3] metres, sensor frame @return the sweep's time_s itself without a
/// rolling shutter
double facing_time(const Sequence& sequence, const glm::dvec3& point_m, const SweepMoment& sweep);

/// What a ray returned from. The angle of incidence is left in the intensity.
struct SurfaceReturn {
    float range_m;    ///< the offset of its beam taken off; 0 where the ray was dropped
    float intensity;  ///< as the mean beam would measure it from 10 m away
};
/// @param ray  index of a ray of the frame @param number  of the return: 0 the strongest,
/// then those of Scan::second_returns
SurfaceReturn surface_return(const Sequence& sequence, const Frame& frame, std::size_t ray,
                             std::size_t number = 0);

/// The end point of a returned ray in the world, range offset and intensity response of
/// its beam taken off, and when it was seen.
struct WorldReturn {
    glm::dvec3 point_m;
    glm::dvec3 direction;
    double time_s;
    float intensity;  ///< of the surface, see SurfaceReturn
};
/// @param ray  index of a returned ray of the frame @param number  of a return that it
/// has
WorldReturn world_return(const Sequence& sequence, const Frame& frame, std::size_t ray,
                         std::size_t number = 0);

/// Whether a world point lies in any box that moves, each box grown by margin_m, at time
/// t_s. Boxes are interpolated in time; they are absent before their first and after
/// their last observation, half a step between observations allowed, for the rays of the
/// sweep in which they were labelled.
bool in_moving_box(const std::vector<BoxTrack>& boxes, const glm::dvec3& point_m, double t_s,
                   double margin_m);

/// How well beams agree on planes that several of them have seen.
struct LaserCalibration {
    std::size_t returns = 0;  ///< that were compared
    double rms_before = 0.0;  ///< of points about their plane, metres
    double rms_after = 0.0;   ///< with an offset for each beam
    bool adopted = false;     ///< whether the beams have them now
};
/// What was found of intensities.
struct IntensityCalibration {
    std::size_t returns = 0;  ///< that were compared
    double rms_before = 0.0;  ///< of intensities about the mean of their place
    double rms_after = 0.0;   ///< with what was adopted
    bool shared = false;      ///< whether the log has an IntensityResponse now
    bool beams = false;       ///< whether the beams have gains and offsets now
};
/// Finds how intensities fall with range and incidence (Sequence::intensity_response),
/// and gain and offset of each beam (Beam), from returns of the frames at `positions`
/// that fall into the same 0.1 m of a surface, by least squares. Of the two, and of both
/// together, only what brings the error down by 5 % more is adopted: beams that agree
/// have no gains, intensities that the sensor has compensated no fall. The mean beam has
/// gain 1 and offset 0, and so has one that shares no place. (Not in the paper.)
IntensityCalibration calibrate_intensity(Sequence& sequence, const std::vector<int>& positions);
/// Measures how the ranges of each LiDAR scatter (Lidar::range_noise), from second
/// differences between neighbouring firings of a beam, in the given frames: scans need
/// the order of an image. Where a bin has seen fewer than 200 returns its neighbour's
/// value stands; a LiDAR of which no bin has seen so many has none. (Not in the paper.)
/// @param positions  of the frames to look at, in Sequence::frames @return returns that
/// were looked at; 0: nothing was measured
std::size_t measure_range_noise(Sequence& sequence, const std::vector<int>& positions);
/// Finds what each beam adds to its ranges (Beam) from returns on the same planes, cells
/// of 0.3 m, by alternating least squares from the nominal ranges; offsets of all beams
/// average 0, and are 0 where they make the planes less than 3 % thinner. Datasets keep
/// offsets of centimetres between beams. (Not in the paper.)
LaserCalibration calibrate_ranges(Sequence& sequence, const std::vector<int>& positions);

/// Frames for training and for testing.
struct Split {
    std::vector<int> train;  ///< positions in Sequence::frames
    std::vector<int> test;
};
/// Holds out sweeps, each with the frames of all LiDARs that share its index: every
/// `test_every`-th but the first (10, 20, ... of 0:50 with 10), or those that are named.
/// Every tenth of a published part is what is published (Sequence::test_frames).
/// @param test_every  0: none @param test_frames  where not empty, instead of it: indices
/// and ranges without their ends, "13,26,40:45"
/// @throws UsageError for a test_every of 1, for a list with something else in it, a
/// frame that is not there or named twice, and where nothing is left to train on
Split split_frames(const Sequence& sequence, int test_every, const std::string& test_frames = "");

}  // namespace relidar
