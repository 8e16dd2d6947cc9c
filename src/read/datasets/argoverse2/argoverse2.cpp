// SPDX-License-Identifier: Apache-2.0
// Reads Argoverse 2 sensor logs. A sweep is a table with the points of both LiDARs. The
// dataset has moved all points to the vehicle frame at the time in the file name (motion
// compensation). The reader undoes this with the poses of the frames. relidar computes
// world points with the same poses, so the points keep their positions in the world.
#include "read/readers.hpp"

#include <algorithm>
#include <charconv>
#include <map>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/log/log_time.hpp>
#include <relidar/read/clouds.hpp>
#include "base/codecs/feather.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/progress_blocks.hpp"
#include "read/datasets/argoverse2/vlp32c_pair.hpp"
#include "read/kitti/log_files.hpp"
#include "read/scans/broken_scans.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using namespace argoverse2;

constexpr const char* kLidarNames[] = {"up_lidar", "down_lidar"};
// Maximum time between a point and its sweep: two revolutions.
constexpr std::int64_t kLongestOffset_ns = 200'000'000;
constexpr double kFarthestHit_m = 1e4;  // limit of a point's distance

struct SweepFile {
    int number = 0;
    std::int64_t time_ns = 0;
    fs::path path;
};

/// Numbers the sweeps by time, because the names of the files are times.
std::vector<SweepFile> list_sweeps(const fs::path& folder) {
    std::vector<SweepFile> sweeps;
    for (const fs::path& path : list_folder(folder)) {
        if (path.extension() != ".feather") continue;
        const std::string stem = path.stem().string();
        std::int64_t time_ns = 0;
        const auto [end, failed] = std::from_chars(stem.data(), stem.data() + stem.size(), time_ns);
        if (failed != std::errc() || end != stem.data() + stem.size() || time_ns < 0)
            fail(
                "cannot use the file {} as a sweep: its name is not a valid time, expected a time in "
                "nanoseconds",
                path.string());
        sweeps.push_back({0, time_ns, path});
    }
    std::sort(sweeps.begin(), sweeps.end(),
              [](const SweepFile& first, const SweepFile& second) { return first.time_ns < second.time_ns; });
    for (std::size_t i = 0; i < sweeps.size(); ++i) sweeps[i].number = int(i);
    if (sweeps.empty()) fail("{} contains no sweeps, expected files NANOSECONDS.feather", folder.string());
    return sweeps;
}

/// Reads a rigid transform from each row of a table: a quaternion w x y z, and a
/// translation in metres.
std::vector<Pose> read_row_poses(const Feather& table) {
    std::vector<double> q[4], t[3];
    const char* quaternion[] = {"qw", "qx", "qy", "qz"};
    const char* translation[] = {"tx_m", "ty_m", "tz_m"};
    for (int i = 0; i < 4; ++i) q[i] = table.read_numbers(quaternion[i]);
    for (int i = 0; i < 3; ++i) t[i] = table.read_numbers(translation[i]);
    std::vector<Pose> poses;
    for (std::size_t i = 0; i < table.row_count(); ++i) {
        const glm::dquat rotation(q[0][i], q[1][i], q[2][i], q[3][i]);
        if (!(std::abs(glm::length(rotation) - 1.0) < 1e-3))
            fail("{}, columns 'qw' to 'qz': the rotation quaternion in row {} has length {}, expected 1",
                 table.name(), i, glm::length(rotation));
        poses.push_back({glm::normalize(rotation), {t[0][i], t[1][i], t[2][i]}});
    }
    return poses;
}

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
/// sweeps.
PoseTrack read_sweep_poses(const fs::path& pose_file, const std::vector<SweepFile>& sweeps,
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
    for (const SweepFile& sweep : sweeps) {
        const double time_s = seconds_since(sweep.time_ns, origin_ns);
        if (!trajectory.contains_time(time_s))
            fail(
                "{}, column 'timestamp_ns': found no pose at {}, which is the time of a sweep; expected "
                "poses for all sweeps",
                table.name(), sweep.time_ns);
        at_sweeps.append(time_s, trajectory.pose_at(time_s));
    }
    return at_sweeps;
}

/// Rejects unknown lasers, because their numbers select the LiDAR and its beam.
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

/// [sweeps] points of both LiDARs in each sweep
using SweepPairs = std::vector<std::array<SweepPoints, 2>>;

/// Reads all sweeps and splits each into the points of both LiDARs. The first readable
/// sweep shows which laser numbers belong to which LiDAR.
SweepPairs read_sweeps(const std::vector<SweepFile>& files, const std::vector<Lidar>& lidars,
                       const PoseTrack& vehicle_track, const Progress& progress,
                       ScanErrorCollector& broken_scans) {
    std::optional<std::array<int, 2>> halves;
    for (std::size_t at = 0; at < files.size() && !halves; ++at)
        broken_scans.guard(at, [&] {
            halves = match_laser_groups(read_sweep(files[at].path),
                                        {lidars[0].vehicle_from_sensor, lidars[1].vehicle_from_sensor});
        });
    std::array<PoseTrack, 2> ways;
    for (std::size_t l = 0; l < 2; ++l) ways[l] = mount_track(vehicle_track, lidars[l].vehicle_from_sensor);
    SweepPairs sweeps(files.size());
    progress_for(files.size(), progress, "reading sweeps", [&](std::size_t at) {
        broken_scans.guard(at, [&] {
            const RawSweep raw = read_sweep(files[at].path);
            for (std::size_t l = 0; l < 2; ++l)
                sweeps[at][l] =
                    extract_group(raw, halves->at(l), lidars[l], ways[l], vehicle_track.time_s[at]);
        });
    });
    return sweeps;
}

/// Adds a frame with a scan for each sweep and LiDAR. Adds no frame if the LiDAR has no
/// points in the sweep.
void add_sweeps(Log& sequence, const std::vector<SweepFile>& sweep_files, const PoseTrack& vehicle_poses,
                SweepPairs lidar_sweep_points, const Progress& progress,
                const ScanErrorCollector& broken_scans) {
    broken_scans.report_broken(sequence, sweep_files.size());
    std::vector<SweepPoints*> of_frame;
    std::size_t missing = 0;
    for (std::size_t at = 0; at < sweep_files.size(); ++at) {
        if (broken_scans.is_scan_broken(at)) continue;
        for (std::size_t l = 0; l < 2; ++l) {
            SweepPoints& lidar_sweep = lidar_sweep_points[at][l];
            SpinningSensor& sensor = sequence.lidars[l].sensor;
            if (lidar_sweep.points.size() == 0 && ++missing) continue;
            sensor.columns = std::max(sensor.columns, int(lidar_sweep.sweep.firings.size()));
            add_frame(sequence, sweep_files[at].number, vehicle_poses.time_s[at], vehicle_poses.pose[at],
                      int(l));
            of_frame.push_back(&lidar_sweep);
        }
    }
    for (Lidar& lidar : sequence.lidars) {
        if (lidar.sensor.columns == 0)
            fail("{} has no points of the LiDAR {}, expected at least one", sequence.source, lidar.name);
        lidar.sensor.first_azimuth_rad = kPi - kPi / lidar.sensor.columns;
    }
    if (missing > 0)
        sequence.notes.push_back(fmt::format(
            "{} frames are skipped, because their sweep has no points of one of the LiDARs", missing));
    progress_for(of_frame.size(), progress, "assigning points to the fired rays", [&](std::size_t index) {
        Frame& frame = sequence.frames[index];
        frame.scan =
            spinning_scan(of_frame[index]->points, sequence.lidar_of(frame).sensor, of_frame[index]->sweep);
        *of_frame[index] = {};
    });
}

/// Reads the box labels of the loaded sweeps. In the file, a box is in the vehicle frame
/// at the time of its sweep.
std::vector<BoxTrack> read_sweep_boxes(const fs::path& annotation_file, const std::vector<SweepFile>& sweeps,
                                       const PoseTrack& vehicle_poses) {
    const Feather table(annotation_file);
    const std::vector<std::int64_t> times_ns = table.read_integers("timestamp_ns");
    const std::vector<std::string> ids = table.read_texts("track_uuid"),
                                   categories = table.read_texts("category");
    const std::vector<double> length = table.read_numbers("length_m"), width = table.read_numbers("width_m"),
                              height = table.read_numbers("height_m");
    const std::vector<Pose> vehicle_from_box = read_row_poses(table);
    std::map<std::int64_t, std::size_t> sweep_at;
    for (std::size_t i = 0; i < sweeps.size(); ++i) sweep_at[sweeps[i].time_ns] = i;
    std::vector<BoxLabel> labels;
    for (std::size_t i = 0; i < table.row_count(); ++i) {
        const glm::dvec3 size_m(length[i], width[i], height[i]);
        if (!(std::min({size_m.x, size_m.y, size_m.z}) > 0.0))
            fail("{}, columns 'length_m' to 'height_m': row {} is {} x {} x {}, expected all above 0",
                 table.name(), i, size_m.x, size_m.y, size_m.z);
        const auto sweep = sweep_at.find(times_ns[i]);
        if (sweep == sweep_at.end()) continue;
        const std::size_t at = sweep->second;
        labels.push_back({ids[i], categories[i], size_m, vehicle_poses.time_s[at],
                          vehicle_poses.pose[at] * vehicle_from_box[i]});
    }
    std::stable_sort(labels.begin(), labels.end(), [](const BoxLabel& first, const BoxLabel& second) {
        return first.time_s < second.time_s;
    });
    return build_tracks(labels);
}

}  // namespace

Log load_argoverse2(const fs::path& log_folder, const DatasetOptions& options) {
    require_folder(log_folder, "an Argoverse 2 log (sensors/lidar/, city_SE3_egovehicle.feather)");
    const fs::path folder = fs::canonical(log_folder);
    const std::vector<SweepFile> all = list_sweeps(folder / "sensors" / "lidar");
    const FrameRange& range = options.frames;
    const int n_sweeps = int(all.size()), first_sweep = std::min(range.begin, n_sweeps),
              end_sweep = range.end < 0 ? n_sweeps : std::min(range.end, n_sweeps);
    if (first_sweep >= end_sweep)
        fail<UsageError>("frames {}:{} select no sweep of this log, expected numbers in [0, {}]", range.begin,
                         range.end, n_sweeps - 1);
    const std::vector<SweepFile> sweeps(all.begin() + first_sweep, all.begin() + end_sweep);
    // Time 0 is the first sweep of the full log, not of the loaded range.
    const PoseTrack vehicle_track =
        read_sweep_poses(folder / "city_SE3_egovehicle.feather", sweeps, all[0].time_ns);
    Log sequence;
    sequence.name = "Argoverse 2 " + folder.filename().string();
    sequence.source = log_folder.string();
    sequence.conventions =
        "Vehicle frame: x forward, y left, z up, in metres, with the origin at the rear axle. Times are "
        "seconds after the first sweep, from the file names. The world frame is that of the city. The motion "
        "compensation of the points is removed. Boxes are labelled in all directions.";
    set_log_start(sequence, all[0].time_ns, "on the clock of the file names");
    sequence.lidars = read_lidars(folder / "calibration" / "egovehicle_SE3_sensor.feather");
    for (Lidar& lidar : sequence.lidars) lidar.sensor.max_range_m = options.max_range_m;
    if (does_path_exist(folder / "annotations.feather"))
        sequence.boxes = read_sweep_boxes(folder / "annotations.feather", sweeps, vehicle_track);
    else sequence.notes.push_back("annotations.feather is missing, so this log has no labels");
    ScanErrorCollector broken(options.skip_broken);
    SweepPairs read = read_sweeps(sweeps, sequence.lidars, vehicle_track, options.progress, broken);
    add_sweeps(sequence, sweeps, vehicle_track, std::move(read), options.progress, broken);
    kitti::replace_poses(sequence, options.poses_file);
    centre_log(sequence);
    return sequence;
}

}  // namespace relidar
