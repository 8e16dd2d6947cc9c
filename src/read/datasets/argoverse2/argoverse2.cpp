// SPDX-License-Identifier: Apache-2.0
// Reads Argoverse 2 sensor logs. A sweep is a table with the points of both LiDARs. The
// dataset has moved all points to the vehicle frame at the time in the file name (motion
// compensation). The reader undoes this with the poses of the frames. relidar computes
// world points with the same poses, so the points keep their positions in the world.
// A VLP-32C fires its 32 lasers in pairs: one pair every 2.304 us.
#include "read/readers.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <map>
#include <optional>
#include <utility>
#include <variant>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/log_time.hpp>
#include <relidar/log/sensor_pattern.hpp>
#include <relidar/read/clouds.hpp>
#include "base/codecs/feather.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/progress_blocks.hpp"
#include "read/scans/broken_scans.hpp"
#include "read/scans/fired_sweeps.hpp"
#include "read/scans/pose_files.hpp"
#include "read/scans/stamped_log.hpp"
#include "read/scans/sweep_firings.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr double kFiringCycle_ns = 55296.0, kRate_hz = 10.0;
constexpr const char* kVlp32cName = "VLP-32C";
constexpr int kLasersPerLidar = 32;

/// [VLP-32C channels] Laser number of each channel in Argoverse 2 files, modulo 32. The
/// files number the lasers of two LiDARs 0 to 63. Derived from a published sweep.
constexpr std::array<int, kLasersPerLidar> kLaserNumbers = {31, 13, 1,  17, 29, 9,  3,  21, 27, 12, 5,
                                                            16, 25, 8,  7,  20, 22, 2,  10, 28, 23, 6,
                                                            11, 24, 18, 0,  14, 30, 19, 4,  15, 26};

std::vector<Beam> nominal_beams() {
    return std::get<SpinningSensor>(find_built_in(kVlp32cName, 1, kRate_hz)->pattern).beams;
}

struct Laser {
    std::uint16_t row = 0;        ///< in the range image; 0 is the highest
    double fires_after_ns = 0.0;  ///< time since the start of the firing cycle
    double elevation_rad = 0.0;
};

/// Returns the lasers of a VLP-32C in the order of their numbers in the files.
std::array<Laser, kLasersPerLidar> make_lasers() {
    const std::vector<BeamFiring> firings = read_firings(kVlp32cName);  // [rows]
    const std::vector<Beam> beams = nominal_beams();                    // [rows]
    std::array<Laser, kLasersPerLidar> lasers;
    for (std::size_t row = 0; row < firings.size(); ++row) {
        const int number = kLaserNumbers[std::size_t(firings[row].channel)];
        lasers[std::size_t(number)] = {.row = std::uint16_t(row),
                                       .fires_after_ns = 1e3 * firings[row].offset_us,
                                       .elevation_rad = beams[row].elevation_rad};
    }
    return lasers;
}

/// Returns a laser by its number in the files. Two equal LiDARs have the numbers 0 to 31
/// and 32 to 63.
const Laser& find_laser(std::int64_t number) {
    static const std::array<Laser, kLasersPerLidar> kLasers = make_lasers();
    return kLasers[std::size_t(number % kLasersPerLidar)];
}

/// The points of a sweep with the values and units of the file.
struct RawSweep {
    std::vector<glm::dvec3> point_m;  ///< [n] position in the vehicle frame at the time of the sweep
    std::vector<double> intensity;    ///< [n] intensity of each point, 0 to 255
    std::vector<std::int64_t> laser;  ///< [n] laser number of each point, 0 to 63
    std::vector<std::int64_t> offset_ns;
};

/// Returns the mean absolute difference between the elevation of a point and of its
/// laser, if a LiDAR with this pose measured the points. Each difference counts at most
/// one degree, so that outliers have little influence. Without points, returns 0.
/// @param laser_group  0: points of lasers 0 to 31, 1: points of lasers 32 to 63
double elevation_error_rad(const RawSweep& sweep, int laser_group, const Pose& vehicle_from_lidar) {
    const Pose lidar_from_vehicle = inverse(vehicle_from_lidar);
    constexpr double kLargestDifference_rad = kPi / 180.0;
    double sum = 0.0, n = 0.0;
    for (std::size_t i = 0; i < sweep.point_m.size(); ++i) {
        if (sweep.laser[i] / kLasersPerLidar != laser_group) continue;
        const glm::dvec3 p = lidar_from_vehicle * sweep.point_m[i];
        const double elevation = std::atan2(p.z, std::hypot(p.x, p.y));
        sum +=
            std::min(std::abs(elevation - find_laser(sweep.laser[i]).elevation_rad), kLargestDifference_rad);
        n += 1.0;
    }
    return n > 0.0 ? sum / n : 0.0;
}

/// Returns the index of the firing cycle of each point, which can be negative. All lasers
/// of a LiDAR fire once per cycle. Cycles start at phase + index * kFiringCycle_ns, with
/// the same phase for all points. The phase is a circular mean: each time is an angle,
/// one cycle is a full turn, and the mean of the unit vectors is free of the index.
/// @param cycle_starts_ns  [points] measured start of the cycle of each point
std::vector<int> number_cycles(const std::vector<double>& cycle_starts_ns) {
    std::complex<double> sum = 0.0;
    for (const double start_ns : cycle_starts_ns)
        sum += std::polar(1.0, 2.0 * kPi * start_ns / kFiringCycle_ns);
    const double phase_ns = std::arg(sum) / (2.0 * kPi) * kFiringCycle_ns;
    std::vector<int> cycles;
    for (const double start_ns : cycle_starts_ns)
        cycles.push_back(int(std::lround((start_ns - phase_ns) / kFiringCycle_ns)));
    return cycles;
}

/// Returns a VLP-32C with the beam angles of the data sheet, highest beam first.
/// @param clockwise  direction of rotation in the sensor frame, seen from +z
SpinningSensor make_vlp32c(bool clockwise) {
    SpinningSensor sensor;
    sensor.name = kVlp32cName;
    sensor.clockwise = clockwise;
    sensor.period_s = 1.0 / kRate_hz;
    sensor.beams = nominal_beams();  // of a head that rotates clockwise
    if (clockwise) return sensor;
    const std::vector<BeamFiring> firings = read_firings(kVlp32cName);
    for (std::size_t row = 0; row < firings.size(); ++row) {
        // A laser fires after the first pair of lasers, when the head has turned by
        // rotated_rad. The nominal offset is that of the laser in the head minus
        // rotated_rad (clockwise). Counterclockwise, it is plus rotated_rad.
        const double rotated_rad = 2.0 * kPi * kRate_hz * 1e-6 * firings[row].offset_us;
        sensor.beams[row].azimuth_offset_rad += 2.0 * rotated_rad;
    }
    return sensor;
}

/// Finds out which lasers belong to each of the two LiDARs. Returns one value per LiDAR:
/// 0 for the lasers 0 to 31, and 1 for the lasers 32 to 63. Chooses the assignment for
/// which the elevations of points and lasers agree best.
std::array<int, 2> match_laser_groups(const RawSweep& sweep, const std::array<Pose, 2>& vehicle_from_lidar) {
    const double straight = elevation_error_rad(sweep, 0, vehicle_from_lidar[0]) +
                            elevation_error_rad(sweep, 1, vehicle_from_lidar[1]);
    const double crossed = elevation_error_rad(sweep, 1, vehicle_from_lidar[0]) +
                           elevation_error_rad(sweep, 0, vehicle_from_lidar[1]);
    return straight <= crossed ? std::array{0, 1} : std::array{1, 0};
}

/// Returns the points of one LiDAR, and the firing cycle of each, in which all lasers
/// fire once. Keeps cycles without points, such as where the vehicle blocks all beams.
/// @param laser_group  lasers of this LiDAR; 0: numbers 0 to 31, 1: numbers 32 to 63
/// @param world_from_sensor  poses with which the dataset compensated the motion
read::FiredSweep extract_group(const RawSweep& raw_sweep, int laser_group, const Lidar& lidar,
                               const PoseTrack& world_from_sensor, double sweep_time_s) {
    const Pose lidar_from_vehicle = inverse(lidar.vehicle_from_sensor);
    read::FiredSweep result;
    std::vector<double> cycle_starts_ns;  // [points of the LiDAR]
    for (std::size_t i = 0; i < raw_sweep.point_m.size(); ++i) {
        if (raw_sweep.laser[i] / kLasersPerLidar != laser_group) continue;
        const Laser& laser = find_laser(raw_sweep.laser[i]);
        result.points.position_m.emplace_back(lidar_from_vehicle * raw_sweep.point_m[i]);
        result.points.intensity.push_back(float(raw_sweep.intensity[i] / 255.0));
        result.points.ring.push_back(laser.row);
        result.points.time_offset_s.push_back(float(double(raw_sweep.offset_ns[i]) * 1e-9));
        cycle_starts_ns.push_back(double(raw_sweep.offset_ns[i]) - laser.fires_after_ns);
    }
    if (result.points.size() == 0) return result;
    undo_deskew(result.points, world_from_sensor, sweep_time_s);
    // The head rotates by this azimuth in a firing cycle.
    const double step_rad = (lidar.sensor.clockwise ? -2.0 : 2.0) * kPi * kRate_hz * kFiringCycle_ns * 1e-9;
    result.sweep = arrange_firings(result.points, number_cycles(cycle_starts_ns), lidar.sensor, step_rad);
    return result;
}

constexpr const char* kLidarNames[] = {"up_lidar", "down_lidar"};
// Maximum time between a point and its sweep: two revolutions.
constexpr std::int64_t kLongestOffset_ns = 200'000'000;
constexpr double kFarthestHit_m = 1e4;  // limit of a point's distance

/// Reads a pose from each row of a table: a quaternion w x y z, and a position in metres.
std::vector<Pose> read_row_poses(const Feather& table) {
    const auto column = [&](const char* name) { return table.read_numbers(name); };
    const std::vector<double> w = column("qw"), x = column("qx"), y = column("qy"), z = column("qz"),
                              tx_m = column("tx_m"), ty_m = column("ty_m"), tz_m = column("tz_m");
    std::vector<Pose> poses;
    for (std::size_t i = 0; i < table.row_count(); ++i) {
        const glm::dquat rotation(w[i], x[i], y[i], z[i]);
        if (!(std::abs(glm::length(rotation) - 1.0) < 1e-3))
            fail("{}, columns 'qw' to 'qz': the rotation quaternion in row {} has length {}, expected 1",
                 table.name(), i, glm::length(rotation));
        poses.push_back({glm::normalize(rotation), {tx_m[i], ty_m[i], tz_m[i]}});
    }
    return poses;
}

/// Reads the poses of both LiDARs on the vehicle and returns their models.
std::vector<Lidar> read_lidars(const fs::path& calibration_file) {
    const Feather table(calibration_file);
    const std::vector<std::string> names = table.read_texts("sensor_name");
    const std::vector<Pose> poses = read_row_poses(table);
    std::vector<Lidar> lidars;
    for (const char* name : kLidarNames) {
        const auto row = std::find(names.begin(), names.end(), name);
        if (row == names.end())
            fail("{}, column 'sensor_name': the sensor {} is missing", table.name(), name);
        const Pose& mounted = poses[std::size_t(row - names.begin())];
        // Seen from above, both LiDARs rotate clockwise. The lower LiDAR is mounted
        // upside down, so it rotates counterclockwise in its own frame.
        const bool upright = (mounted.rotation * glm::dvec3(0, 0, 1)).z > 0.0;
        lidars.push_back({name, make_vlp32c(upright), mounted});
    }
    return lidars;
}

double seconds_since(std::int64_t time_ns, std::int64_t origin_ns) {
    return double(time_ns - origin_ns) * 1e-9;
}

/// Reads vehicle poses in the city frame, and interpolates them at the times of the
/// sweeps. Times of the result are seconds after `origin_ns`.
PoseTrack read_sweep_poses(const fs::path& pose_file, const std::vector<read::StampedScanFile>& sweeps,
                           std::int64_t origin_ns) {
    const Feather table(pose_file);
    const std::vector<std::int64_t> times_ns = table.read_integers("timestamp_ns");
    PoseTrack trajectory{{}, read_row_poses(table)};
    for (std::size_t i = 0; i < times_ns.size(); ++i) {
        if (i > 0 && times_ns[i] <= times_ns[i - 1])
            fail("{}, column 'timestamp_ns': row {} is {} after {}, expected increasing times", table.name(),
                 i, times_ns[i], times_ns[i - 1]);
        trajectory.time_s.push_back(seconds_since(times_ns[i], origin_ns));
    }
    PoseTrack at_sweeps;
    for (const read::StampedScanFile& sweep : sweeps) {
        const double time_s = seconds_since(sweep.stamp, origin_ns);
        if (!trajectory.contains_time(time_s))
            fail(
                "{}, column 'timestamp_ns': found no pose at {}, which is the time of a sweep; expected "
                "poses for all sweeps",
                table.name(), sweep.stamp);
        at_sweeps.append(time_s, trajectory.pose_at(time_s));
    }
    return at_sweeps;
}

/// Reads the points of a sweep file. Rejects unknown lasers, because their numbers select
/// the LiDAR and its beam, and values that cannot be in the units of the dataset.
RawSweep read_sweep(const fs::path& file) {
    const Feather table(file);
    if (table.row_count() == 0) throw DataError(table.name() + ": the file has no points, expected a sweep");
    RawSweep sweep;
    const std::vector<double> x = table.read_numbers("x"), y = table.read_numbers("y"),
                              z = table.read_numbers("z");
    sweep.intensity = table.read_numbers("intensity");
    sweep.laser = table.read_integers("laser_number");
    sweep.offset_ns = table.read_integers("offset_ns");
    for (std::size_t i = 0; i < x.size(); ++i) {
        sweep.point_m.emplace_back(x[i], y[i], z[i]);
        if (!(glm::length(sweep.point_m[i]) < kFarthestHit_m))
            fail("{}: point {} is ({}, {}, {}), expected coordinates in metres of at most {}", table.name(),
                 i, x[i], y[i], z[i], kFarthestHit_m);
        if (sweep.laser[i] < 0 || sweep.laser[i] >= 2 * kLasersPerLidar)
            fail("{}, column 'laser_number': row {} is {}, expected 0 to {}", table.name(), i, sweep.laser[i],
                 2 * kLasersPerLidar - 1);
        if (std::abs(sweep.offset_ns[i]) > kLongestOffset_ns)
            fail("{}, column 'offset_ns': row {} is {}, expected at most {} nanoseconds", table.name(), i,
                 sweep.offset_ns[i], kLongestOffset_ns);
    }
    return sweep;
}

/// [sweeps] points of both LiDARs
using SweepPairs = std::vector<std::array<read::FiredSweep, 2>>;

/// Reads all sweeps and splits each into the points of both LiDARs. The first readable
/// sweep shows which laser numbers belong to which LiDAR. Without one, all are skipped.
/// @param vehicle_track  one pose per file
/// @param broken_scans  its guard() skips a broken sweep, or throws its error
SweepPairs read_sweeps(const std::vector<read::StampedScanFile>& files, const std::vector<Lidar>& lidars,
                       const PoseTrack& vehicle_track, const Progress& progress,
                       ScanErrorCollector& broken_scans) {
    std::optional<std::array<int, 2>> laser_groups;  // [LiDARs] 0: lasers 0 to 31, 1: lasers 32 to 63
    for (std::size_t i = 0; i < files.size() && !laser_groups; ++i)
        broken_scans.guard(i, [&] {
            laser_groups = match_laser_groups(read_sweep(files[i].file),
                                              {lidars[0].vehicle_from_sensor, lidars[1].vehicle_from_sensor});
        });
    std::array<PoseTrack, 2> lidar_tracks;
    for (std::size_t l = 0; l < 2; ++l)
        lidar_tracks[l] = mount_track(vehicle_track, lidars[l].vehicle_from_sensor);
    SweepPairs sweeps(files.size());
    progress_for(files.size(), progress, "reading sweeps", [&](std::size_t i) {
        broken_scans.guard(i, [&] {
            const RawSweep raw = read_sweep(files[i].file);
            for (std::size_t l = 0; l < 2; ++l)
                sweeps[i][l] = extract_group(raw, laser_groups->at(l), lidars[l], lidar_tracks[l],
                                             vehicle_track.time_s[i]);
        });
    });
    return sweeps;
}

/// Adds a frame with a scan for each sweep and LiDAR, unless the LiDAR has no points.
void add_sweeps(Log& log, const std::vector<read::StampedScanFile>& sweep_files,
                const PoseTrack& vehicle_poses, SweepPairs sweep_pairs, const Progress& progress,
                const ScanErrorCollector& broken_scans) {
    broken_scans.report_broken(log, sweep_files.size());
    std::vector<read::FiredSweep> sweeps;
    std::size_t n_missing = 0;
    for (std::size_t i = 0; i < sweep_files.size(); ++i) {
        if (broken_scans.is_scan_broken(i)) continue;
        for (std::size_t l = 0; l < 2; ++l) {
            if (sweep_pairs[i][l].points.size() == 0) {
                ++n_missing;
                continue;
            }
            add_frame(log, sweep_files[i].number, vehicle_poses.time_s[i], vehicle_poses.pose[i], int(l));
            sweeps.push_back(std::move(sweep_pairs[i][l]));
        }
    }
    read::set_fired_scans(log, sweeps, progress);
    for (const Lidar& lidar : log.lidars)
        if (lidar.sensor.columns == 0)  // no firing in any sweep
            fail("{} has no points of the LiDAR {}, expected at least one", log.source, lidar.name);
    if (n_missing > 0)
        log.notes.push_back(fmt::format(
            "{} frames are skipped, because their sweep has no points of one of the LiDARs", n_missing));
}

/// Reads the box labels of the loaded sweeps, which are in the vehicle frame of a sweep.
std::vector<BoxTrack> read_sweep_boxes(const fs::path& annotation_file,
                                       const std::vector<read::StampedScanFile>& sweeps,
                                       const PoseTrack& vehicle_poses) {
    const Feather table(annotation_file);
    const std::vector<std::int64_t> times_ns = table.read_integers("timestamp_ns");
    const std::vector<std::string> ids = table.read_texts("track_uuid"),
                                   categories = table.read_texts("category");
    const std::vector<double> length = table.read_numbers("length_m"), width = table.read_numbers("width_m"),
                              height = table.read_numbers("height_m");
    const std::vector<Pose> vehicle_from_box = read_row_poses(table);
    std::map<std::int64_t, std::size_t> sweep_of_time;
    for (std::size_t i = 0; i < sweeps.size(); ++i) sweep_of_time[sweeps[i].stamp] = i;
    std::vector<BoxLabel> labels;
    for (std::size_t row = 0; row < table.row_count(); ++row) {
        const auto entry = sweep_of_time.find(times_ns[row]);
        if (entry == sweep_of_time.end()) continue;  // a sweep that is not loaded
        const std::size_t sweep = entry->second;
        const glm::dvec3 size_m(length[row], width[row], height[row]);
        labels.push_back({ids[row], categories[row], size_m, vehicle_poses.time_s[sweep],
                          vehicle_poses.pose[sweep] * vehicle_from_box[row]});
    }
    std::ranges::stable_sort(labels, {}, &BoxLabel::time_s);
    return build_tracks(labels);
}

}  // namespace

/// Loads an Argoverse 2 log: poses and boxes of the sweeps, both LiDARs, and their scans
/// without the motion compensation of the dataset.
Log load_argoverse2(const fs::path& log_folder, const DatasetOptions& options) {
    require_folder(log_folder, "an Argoverse 2 log (sensors/lidar/, city_SE3_egovehicle.feather)");
    const fs::path folder = fs::canonical(log_folder);
    const std::vector<read::StampedScanFile> all =
        read::list_stamped_files(folder / "sensors" / "lidar", ".feather");
    const FrameRange loaded = limit_frames(options.frames, int(all.size()), folder.filename().string());
    const std::vector<read::StampedScanFile> sweeps(all.begin() + loaded.begin, all.begin() + loaded.end);
    // Time 0 is the first sweep of the full log, not of the loaded range.
    const PoseTrack vehicle_track =
        read_sweep_poses(folder / "city_SE3_egovehicle.feather", sweeps, all[0].stamp);
    Log log;
    log.name = "Argoverse 2 " + folder.filename().string();
    log.source = log_folder.string();
    log.conventions =
        "Vehicle frame: x forward, y left, z up, in metres, with the origin at the rear axle. Times are "
        "seconds after the first sweep, from the file names. The world frame is that of the city. The motion "
        "compensation of the points is removed. Boxes are labelled in all directions.";
    set_log_start(log, all[0].stamp, "on the clock of the file names");
    log.lidars = read_lidars(folder / "calibration" / "egovehicle_SE3_sensor.feather");
    for (Lidar& lidar : log.lidars) lidar.sensor.max_range_m = options.max_range_m;
    if (does_path_exist(folder / "annotations.feather"))
        log.boxes = read_sweep_boxes(folder / "annotations.feather", sweeps, vehicle_track);
    else log.notes.push_back("annotations.feather is missing, so this log has no labels");
    ScanErrorCollector broken(options.skip_broken);
    SweepPairs read = read_sweeps(sweeps, log.lidars, vehicle_track, options.progress, broken);
    add_sweeps(log, sweeps, vehicle_track, std::move(read), options.progress, broken);
    read::replace_poses(log, options);
    centre_log(log);
    return log;
}

}  // namespace relidar
