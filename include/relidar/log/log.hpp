// SPDX-License-Identifier: Apache-2.0
// A LiDAR log: scans with their rays, sensor poses over time, tracked boxes, and the
// split into training and test frames.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <relidar/base/math.hpp>
#include <relidar/log/body_table.hpp>
#include <relidar/log/classes.hpp>
#include <relidar/log/conventions.hpp>
#include <relidar/log/georeference.hpp>
#include <relidar/log/sensor.hpp>

namespace relidar {

/// Position of a time in a track, between the entries `left` and `left + 1`. `s` is the
/// fraction of the way; below 0 before the first entry, above 1 after the last.
struct TrackInterpolation {
    std::size_t left = 0;
    double s = 0.0;  ///< 0 if the track has only one entry
};

/// Poses at ascending times.
struct PoseTrack {
    std::vector<double> time_s;
    std::vector<Pose> pose;

    void append(double at_s, const Pose& pose_at_s) {
        time_s.push_back(at_s);
        pose.push_back(pose_at_s);
    }
    /// Returns the interpolated pose at a time (slerp for rotations, lerp for
    /// translations). Outside the track, extrapolates with the velocity at its end.
    /// @throws DataError if the track is empty
    Pose pose_at(double t_s) const;
    /// Returns the pose at `t_s` of an object that is mounted on the object of this
    /// track. Same as mount_track() followed by pose_at().
    Pose mounted_pose_at(double t_s, const Pose& carrier_from_mounted) const;
    /// @throws DataError if the track is empty
    TrackInterpolation find_segment(double t_s) const;
    bool contains_time(double t_s) const {
        return !time_s.empty() && t_s >= time_s.front() && t_s <= time_s.back();
    }
};

/// All second returns of a scan, or all third returns, and so on.
struct AdditionalReturns {
    std::vector<float> range_m;    ///< [n] range along the ray from its origin; 0 = no such return
    std::vector<float> intensity;  ///< [n] 0..1; 0 if there is no such return
};

/// A measured or simulated sweep: its rays and the returns of each ray.
struct Scan {
    RayTable rays;  ///< for a ray with a return: its measured direction and origin
    /// [n] range of the strongest return along the ray. 0 if the ray was dropped.
    ScanArray<float> range_m;
    ScanArray<float> intensity;  ///< [n] intensity of the strongest return, 0..1; 0 if dropped
    /// Second, third, ... returns of all rays. A dropped ray has no further returns.
    std::vector<AdditionalReturns> second_returns = {};
    ScanArray<SurfaceClass> classes = {};  ///< [n] class of the strongest return; empty without labels

    /// Returns the end point of a ray: [3] metres, sensor frame at its firing time.
    glm::vec3 return_point(std::size_t index_of_ray) const {
        return rays.origin[index_of_ray] + range_m[index_of_ray] * rays.direction[index_of_ray];
    }
    std::size_t count_returns() const;
};

/// Removes the returns of a scan, also second returns, whose range is outside the limits.
void limit_ranges(Scan& scan, const RangeLimits& limits);

/// Azimuth of a LiDAR's head at the start of a sweep, and the time of this start relative
/// to the reference time of the frame.
struct SweepStart {
    double azimuth_rad = 0.0;  ///< azimuth of the head; 0 for a LiDAR that does not spin
    double time_s = 0.0;
};

/// Computes azimuth and time of a sweep's start from its rays. Returns nothing if the
/// start is the default (facing backward, half a period before time 0), if the LiDAR does
/// not spin, or if the times and azimuths of the rays are inconsistent.
std::optional<SweepStart> find_sweep_start(const RayTable& rays, const SpinningSensor& sensor);

/// A sweep of one LiDAR of the log.
struct Frame {
    /// Frame number in the dataset. LiDARs that sweep at the same time share this number.
    int index = 0;
    /// Reference time. A spinning LiDAR faces forward at this time if `start` is empty.
    double time_s = 0.0;
    Scan scan;
    int lidar = 0;  ///< index into Log::lidars
    /// Azimuth and time at the start of the sweep; empty if both have default values
    std::optional<SweepStart> start = {};
    /// [columns] radians, measured minus nominal azimuth of the head at each firing.
    /// Empty if there is none. load_log() sets it.
    std::vector<float> azimuth_shift_rad = {};
};

inline Frame strip_scan(const Frame& frame) {
    return {frame.index, frame.time_s, {}, frame.lidar, frame.start, frame.azimuth_shift_rad};
}

/// LiDAR, time and start of a sweep.
struct SweepTiming {
    double time_s = 0.0;  ///< reference time of the sweep
    int lidar = 0;        ///< index into Log::lidars
    std::optional<SweepStart> start = {};
};
/// Returns the recorded timing of a frame.
inline SweepTiming timing_of(const Frame& frame) { return {frame.time_s, frame.lidar, frame.start}; }
struct Lidar;
/// Returns the start of a sweep of any LiDAR, or nothing if it is the default (half a
/// period before the reference time) or unknown (no scan pattern, or equal ray times).
std::optional<SweepStart> find_sweep_start(const RayTable& rays, const Lidar& lidar);

/// Standard deviation of measured ranges, as a table over range and incidence angle.
struct RangeNoiseTable {
    /// Upper limits of the bins, ascending. Empty if unknown.
    std::vector<double> range_m, cosine;
    /// [ranges*cosines] standard deviations along the ray, a row for each range
    std::vector<double> sigma_m;

    /// Returns the standard deviation of the range noise in the bin of these values, or
    /// in the nearest bin; 0 if the noise is unknown.
    double lookup_sigma_m(double measured_range_m, double incidence_cosine) const;
};

/// A LiDAR of a log.
struct Lidar {
    std::string name;  ///< Name in the dataset. Empty if the log has only one LiDAR.
    /// Nominal sensor, whose rays frames without a scan get. For a LiDAR that does not
    /// spin, it has no beams and period 0.
    SpinningSensor sensor;
    /// Pose of the sensor in the vehicle frame; the identity if the log has one LiDAR.
    Pose vehicle_from_sensor;
    /// Nominal scan pattern of a LiDAR that does not spin. Empty otherwise or if unknown.
    std::optional<SensorPattern> pattern = {};
    RangeNoiseTable range_noise = {};  ///< range noise; empty unless it was measured
    BodyTable own_body = {};           ///< what carries the LiDAR; empty unless prepare_log() found it

    /// Returns the duration of a sweep, or 0 if it is unknown.
    double sweep_period_s() const { return pattern ? scan_period_s(*pattern) : sensor.period_s; }
};

/// A pinhole camera without distortion: x right, y down, z forward. The centre of a pixel
/// has integer coordinates.
struct Camera {
    std::string name;
    double focal_x_px = 0.0, focal_y_px = 0.0, centre_x_px = 0.0, centre_y_px = 0.0;
    int columns = 0, rows = 0;
    Pose rig_from_camera = {};  ///< to the frame of the log's LiDAR: forward, left, up

    /// Returns the pixel (u, v), also outside the picture; nothing if not in front.
    std::optional<glm::dvec2> project(const glm::dvec3& point_m) const;
    glm::dvec3 direction_of(const glm::dvec2& pixel) const;  ///< unit vector from the camera
    bool contains(const glm::dvec2& pixel) const;
};

/// Sets the nominal sensor of a LiDAR, either its beams or its scan pattern.
void set_sensor(Lidar& lidar, const SensorModel& sensor);
/// Returns the nominal (ideal) sensor of a LiDAR. It has no beams if it is unknown.
SensorModel sensor_of(const Lidar& lidar);

/// Returns the rays that a LiDAR nominally fires at a time; none if its sensor is
/// unknown.
RayTable make_lidar_rays(const Lidar& lidar, double time_s);

/// Measures the difference between the actual and the nominal azimuth of a spinning head,
/// at each firing of a sweep, positive to the left. The value is the median over all
/// returned rays of the firing, so it does not reveal which rays were dropped. Firings
/// with less than three returns are interpolated.
/// @param table  make_lidar_rays() of the LiDAR
/// @return [columns] radians, by firing (offset_columns()). Empty if
/// the rays are not in nominal order, the beams do not rotate together, or none deviates.
std::vector<float> measure_shifts_rad(const Scan& scan, const SpinningSensor& sensor, const RayTable& table);
/// Rotates the nominal rays of each firing about the z axis to the measured azimuth.
/// @param shifts_rad  result of measure_shifts_rad(). Empty: no rotation
RayTable rotate_firings(RayTable nominal, const SpinningSensor& sensor, const std::vector<float>& shifts_rad);

/// Category of moving objects without a label that discover_tracks() found in the scans.
inline constexpr const char* kDiscoveredCategory = "Discovered";
/// Margin around boxes of moving objects, because labelled boxes do not fit exactly.
inline constexpr double kMoverMargin_m = 0.2;

/// A tracked box. Box frame: origin at the centre, x along the length, y along the width,
/// z up.
struct BoxTrack {
    std::string id;          ///< unique in the log
    std::string category;    ///< class name in the dataset, or kDiscoveredCategory
    glm::dvec3 size_m{0.0};  ///< length, width, height
    PoseTrack world_from_box;
    /// Kind of object, for example a car, if the box has no label and its size is the
    /// typical size of this kind, because scans show only one side.
    std::string size_guess = {};
    /// Numbers of poses that discover_tracks() added before and after the labels.
    std::size_t n_before = 0, n_after = 0;

    /// Returns true if the object moves, as far as its poses can show this. Positions are
    /// averaged over one second or half of a shorter track, because labels jitter and the
    /// poses of a log drift. An object moves only in one of these cases:
    /// - An average position is farther from the first average than 2 m, or than half the
    ///   longer side of the box but at least 0.2 m.
    /// - Between two successive averages the object moves faster than 0.5 m/s and by more
    ///   than 0.2 m.
    bool is_moving() const;
    /// Returns true if the box was observed at a time, give or take half a mean time
    /// step.
    bool is_observed(double t_s) const;
    /// Returns the track without the poses before its first and after its last label.
    BoxTrack labelled_part() const;
    /// Returns true if a point in the world frame is in the box, enlarged by margin_m on
    /// all sides, at a time.
    bool contains_point(const glm::dvec3& point_m, double t_s, double margin_m) const;
};

/// Model of the measured intensity, the same for all beams of a log. The factor is 1 at
/// 10 m and perpendicular incidence.
///   intensity of the mean beam = albedo * range_factor(range)
///                                * incidence_factor(cosine)
struct IntensityResponse {
    /// Ranges in metres, ascending, of the factors. Empty: the factor is 1 at all ranges.
    std::vector<double> range_m;
    /// [knots] positive; between two knots, the factor is a power of the range.
    std::vector<double> factor;
    double incidence = 0.0;  ///< dependence on incidence: 0 none, 1 Lambert's cosine law

    double range_factor(double distance_m) const;  ///< uses the first or last factor outside the knots
    /// `incidence_cosine`: cosine of the angle between ray and normal
    double incidence_factor(double incidence_cosine) const {
        return 1.0 - incidence * (1.0 - incidence_cosine);
    }
};

/// A message for users about data that a log lacks or that are probably wrong.
struct Note {
    /// Check that found the fault. Loading a log repeats it, so save_folder() leaves out
    /// notes with an id. Empty for messages of a reader.
    std::string id;
    int lidar = -1;    ///< index into Log::lidars; -1: not about a single LiDAR
    std::string text;  ///< one line

    Note(std::string note_text) : text(std::move(note_text)) {}
    Note(const char* note_text) : text(note_text) {}
    Note(std::string note_id, int lidar_index, std::string note_text)
        : id(std::move(note_id)), lidar(lidar_index), text(std::move(note_text)) {}
    operator const std::string&() const { return text; }
    bool operator==(const Note&) const = default;
};
using Notes = std::vector<Note>;

/// A LiDAR log. Its world origin is the vehicle in the middle frame.
struct Log {
    std::string name;
    std::string source;                                 ///< path of the log
    std::vector<Lidar> lidars = std::vector<Lidar>(1);  ///< LiDARs, at least one
    std::vector<Camera> cameras = {};                   ///< relative to the first LiDAR
    std::vector<Frame> frames;                          ///< frames of all LiDARs, ascending in time
    PoseTrack world_from_vehicle;                       ///< an entry for each time that has frames
    std::vector<BoxTrack> boxes;
    /// Add this vector to coordinates in relidar's world frame to get coordinates in the
    /// dataset's world frame.
    glm::dvec3 world_offset_m{0.0};
    std::optional<Georeference> georeference = {};  ///< empty if the place on the earth is unknown
    IntensityResponse intensity_response;           ///< of all LiDARs
    std::string conventions;         ///< a single line for users: frames, units, time reference
    std::int64_t start_unix_ns = 0;  ///< date of time 0: nanoseconds since 1970; 0 if unknown
    std::vector<UsedConvention> conventions_used = {};  ///< of the points, poses and boxes
    Notes notes;
    /// Indices of the test frames in published results on this part of the dataset.
    std::vector<int> test_frames = {};
    /// False: all poses are the identity before registration.
    bool has_poses = true;
    /// True: the rays of a scan were fired at different times and not motion-compensated.
    bool rolling_shutter = true;

    const Lidar& lidar_of(const Frame& frame) const { return lidars[std::size_t(frame.lidar)]; }
    /// Returns the index of the vehicle pose that has the time of a frame.
    /// @throws DataError if there is no such pose
    std::size_t find_pose_index(const Frame& frame) const;
    /// Returns the poses of a LiDAR at the times of the vehicle's poses.
    PoseTrack lidar_track(int lidar_index) const;
    std::size_t count_beams() const;
    /// Returns the number of a beam among the beams of all LiDARs, in the order of
    /// `lidars`, or nothing if the LiDAR does not have the beam.
    std::optional<std::uint16_t> find_global_beam(int lidar_index, std::uint16_t channel) const;
};

/// Returns the box with this id, or null if there is none or the id is empty.
const BoxTrack* find_box(const Log& log, const std::string& box_id);

/// Returns a copy of a log without its frames.
Log strip_frames(const Log& log);

/// Returns the index of the LiDAR with this name. An empty name gives the first LiDAR.
/// @throws UsageError if no LiDAR has this name
int find_lidar(const Log& log, const std::string& name);

/// Returns the poses of an object that is mounted on another moving object, its carrier.
PoseTrack mount_track(PoseTrack carrier_track, const Pose& carrier_from_mounted);
/// Returns the same motion with additional poses where the object turns, so that a
/// mounted object moves on a curve.
PoseTrack subdivide_turns(const PoseTrack& track);
/// Adds a vector to all positions. Log::world_offset_m converts from relidar's
/// world frame to the dataset's world frame, -world_offset_m back.
PoseTrack shift_track(PoseTrack track, const glm::dvec3& offset_m);

/// Replaces the poses of the vehicle. The times must stay the same. Boxes keep their
/// poses relative to the vehicle.
void set_trajectory(Log& log, PoseTrack world_from_vehicle);

/// A ray in the world frame at the time at which it was fired.
struct WorldRay {
    glm::dvec3 origin_m;
    glm::dvec3 direction;
};

/// Converts a ray of a frame to the world frame, with the sensor pose at the ray's firing
/// time if the log has a rolling shutter.
/// @param time_s  reference time of the sweep
/// @param ray  index into `rays`
WorldRay make_world_ray(const PoseTrack& world_from_sensor, double time_s, const RayTable& rays,
                        std::size_t ray, bool rolling_shutter);

/// Returns the time in a sweep at which the LiDAR faces a point. For a scanning window,
/// it is the time of the column that contains the point. For a rosette, which covers
/// every direction repeatedly, or a table of rays, it is the middle of the scan. It is
/// the `time_s` of the sweep without a rolling shutter.
/// @param point_m [3] metres, sensor frame
double facing_time_s(const Log& log, const glm::dvec3& point_m, const SweepTiming& sweep);

/// Range and intensity of the surface that a ray hit, not corrected for the incidence.
struct SurfaceReturn {
    /// without the range offset of the beam; 0 if the ray was dropped
    float range_m;
    float intensity;  ///< intensity that the mean beam would measure at a distance of 10 m
};
/// @param ray  index of a ray of the frame
/// @param index  0 for the strongest return, n for Scan::second_returns[n-1]
SurfaceReturn surface_return(const Log& log, const Frame& frame, std::size_t ray, std::size_t index = 0);

/// End point of a returned ray in the world frame, and the firing time of the ray,
/// without range offset and intensity response of the beam.
struct WorldReturn {
    glm::dvec3 point_m;
    glm::dvec3 direction;
    double time_s;
    float intensity;  ///< intensity that the mean beam would measure at 10 m
};
/// @param ray  index of a returned ray of the frame
/// @param index  number of an existing return of this ray
WorldReturn locate_return(const Log& log, const Frame& frame, std::size_t ray, std::size_t index = 0);

/// Returns true if a point in the world frame is in any moving box at time t_s. The boxes
/// are interpolated, enlarged by margin_m, and exist as in
/// BoxTrack::is_observed().
bool is_in_moving_box(const std::vector<BoxTrack>& boxes, const glm::dvec3& p, double t_s, double margin_m);

/// Distances of the points from common planes, before and after the calibration.
struct RangeCalibrationResult {
    std::size_t returns = 0;  ///< number of returns that were compared
    double rms_before = 0.0;  ///< Root mean square distance of points from their plane, in metres.
    double rms_after = 0.0;   ///< The same distance (RMS) after adding an offset for each beam.
    bool adopted = false;     ///< True if the offsets were stored in the beams.
};
/// Errors before and after the calibration of intensities.
struct IntensityCalibrationResult {
    std::size_t returns = 0;  ///< number of returns that were compared
    /// RMS difference between intensities and their mean at the same point of a surface.
    double rms_before = 0.0;
    double rms_after = 0.0;  ///< The same difference with the corrections that were adopted.
    bool shared = false;     ///< True if the log now has an IntensityResponse.
    bool beams = false;      ///< True if the beams now have gains and offsets.
};
/// Estimates two models of the intensity by least squares: the dependence on range and
/// incidence (Log::intensity_response), and gain and offset of each beam
/// (Beam). Both are fitted to returns that hit the same 0.1 m of a surface. A model, or
/// both together, is adopted only if it reduces the error by a further 5 %. The mean
/// beam, and a beam that shares no surface with others, has gain 1 and offset 0. (Not in
/// the paper.)
/// @param frame_indices  indices into Log::frames of the frames to use
IntensityCalibrationResult calibrate_intensity(Log& log, const std::vector<int>& frame_indices);
/// Measures the range noise of each LiDAR (Lidar::range_noise) from second differences
/// between neighbouring firings of a beam. The scans must be in image order. A bin with
/// fewer than 200 returns uses the value of the neighbouring bin. (Not in the paper.)
/// @param frame_indices  indices into Log::frames of the frames to use
/// @return number of returns that were used; 0: nothing was measured
std::size_t calibrate_noise(Log& log, const std::vector<int>& frame_indices);
/// Estimates the range offset of each beam (Beam), centimetres in many datasets, from
/// returns on the same planes in cells of 0.3 m. Their mean is 0. Offsets that make the
/// planes less than 3 % thinner are set to 0. (Not in the paper.)
/// @param frame_indices  indices into Log::frames of the frames to use
RangeCalibrationResult calibrate_ranges(Log& log, const std::vector<int>& frame_indices);

/// Split of the frames into training and test frames.
struct Split {
    std::vector<int> train;  ///< indices into Log::frames
    std::vector<int> test;
};
/// Splits the frames of a log into training and test frames. A test sweep includes the
/// frames of all LiDARs that have the same index. Test sweeps are every
/// `test_every_nth_frame`-th sweep except the first (10, 20, ... of 0:50 with 10), or,
/// with 10 on a published part of a dataset, Log::test_frames.
/// @param test_every_nth_frame  0: no test frames
/// @param test_frame_list  if not empty, the indices and half-open ranges of the test
/// frames, "13,26,40:45"
/// @throws UsageError for a test_every_nth_frame of 1, for an invalid list, for a frame
/// that does not exist or is named twice, and if no frame is left for training
Split split_frames(const Log& log, int test_every_nth_frame, const std::string& test_frame_list = "");

}  // namespace relidar
