// SPDX-License-Identifier: Apache-2.0
// Reads MulRan. A file contains one revolution with 64 beams x 1024 columns. Missing
// returns are stored as zeros, so the index of a point gives its beam and its time. The
// points are stored column by column or beam by beam; the reader detects the order. The x
// axis of the LiDAR points backward, so the reader rotates its frame by 180 degrees.
#include "read/readers.hpp"

#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/read/clouds.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/scans/stamped_log.hpp"
#include "read/scans/sweep_poses.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kBeams = 64, kColumns = 1024;
constexpr double kRevolution_s = 0.1;
constexpr double kNanosecond = 1e-9;
// maximum gap for interpolation; the dataset has 100 poses per second
constexpr double kMostGap_s = 0.5;
// A beam starts beside the spin axis, which changes the elevation of nearer points.
constexpr double kLeastRange_m = 2.0;
// With a larger deviation within a beam, the points are not sorted by column or by beam.
constexpr double kMostSpread_rad = kPi / 180.0;
// With a smaller mean forward direction, the poses are wrong, and the user gets a note.
constexpr double kMinForwardMotion = 0.9;

/// published pose of the LiDAR on the vehicle: metres; roll, pitch and yaw in degrees
constexpr double kLidarPosition_m[3] = {1.7042, -0.021, 1.8047}, kAngles_deg[3] = {0.0001, 0.0003, 179.6654};

enum class MulranPointOrder { by_column, by_beam };

std::size_t beam_of(std::size_t point, MulranPointOrder point_order) {
    return point_order == MulranPointOrder::by_column ? point % kBeams : point / kColumns;
}
std::size_t column_of(std::size_t point, MulranPointOrder point_order) {
    return point_order == MulranPointOrder::by_column ? point / kBeams : point % kColumns;
}

/// Returns the standard deviation of the elevations within a beam, over all beams. It is
/// small if the points are stored in `point_order`, and infinite without points.
double elevation_spread_rad(const read::PointTable& table, MulranPointOrder point_order) {
    using enum read::PointAttribute;
    const read::PointFieldView &xs = *table.find_field(x), &ys = *table.find_field(y),
                               &zs = *table.find_field(z);
    struct ElevationSums {
        double n = 0.0, sum = 0.0, squares = 0.0;
    };
    std::vector<ElevationSums> beams(kBeams);
    for (std::size_t i = 0; i < table.n; ++i) {
        const glm::dvec3 p(xs[i], ys[i], zs[i]);
        if (!(std::hypot(p.x, p.y, p.z) >= kLeastRange_m)) continue;
        const double elevation = std::atan2(p.z, std::hypot(p.x, p.y));
        ElevationSums& beam = beams[beam_of(i, point_order)];
        beam.n += 1.0;
        beam.sum += elevation;
        beam.squares += elevation * elevation;
    }
    double n = 0.0, squared_deviations = 0.0;  // from the mean of each beam
    for (const ElevationSums& beam : beams)
        if (beam.n > 0.0) {
            n += beam.n;
            squared_deviations += beam.squares - beam.sum * beam.sum / beam.n;
        }
    return n > 0.0 ? std::sqrt(std::max(squared_deviations, 0.0) / n) : INFINITY;
}

void require_all_rays(const read::PointTable& table, const std::string& place) {
    if (table.n != kBeams * kColumns)
        fail("{} has {} points, expected {} x {}, with zeros for rays without return", place, table.n, kBeams,
             kColumns);
}

/// Detects whether files store points by column or by beam. In the correct order, the
/// points of a beam have similar elevations. Uses the first readable scan.
MulranPointOrder detect_order(const std::vector<fs::path>& scan_files) {
    for (const fs::path& file : scan_files) {
        read::PointTable table;
        try {
            table = read::read_point_file(file, {});
            require_all_rays(table, file.string());
        } catch (const DataError&) {
            continue;  // the error is reported when the scan is read
        }
        const double by_column = elevation_spread_rad(table, MulranPointOrder::by_column),
                     by_beam = elevation_spread_rad(table, MulranPointOrder::by_beam);
        if (!(std::min(by_column, by_beam) <= kMostSpread_rad))
            fail(
                "{}: the points of a beam differ in elevation by {:.1f} degrees, expected less than {:.0f}; "
                "the points must be sorted by column or by beam",
                file.string(), std::min(by_column, by_beam) * 180.0 / kPi, kMostSpread_rad * 180.0 / kPi);
        return by_column <= by_beam ? MulranPointOrder::by_column : MulranPointOrder::by_beam;
    }
    return MulranPointOrder::by_column;
}

/// Computes beam and time of each point from its index in the file. The time stamp of the
/// file is the middle of the revolution.
void add_ring_times(read::PointTable& table, MulranPointOrder point_order, const std::string& place) {
    require_all_rays(table, place);
    std::vector<std::uint16_t> ring(table.n);
    std::vector<double> time(table.n);
    for (std::size_t i = 0; i < table.n; ++i) {
        ring[i] = std::uint16_t(beam_of(i, point_order));
        time[i] = kRevolution_s * (double(column_of(i, point_order)) / double(kColumns) - 0.5);
    }
    table.add_value_field("ring", read::ScalarType::u2, std::move(ring), place);
    table.add_value_field("time", read::ScalarType::f8, std::move(time), place);
}

/// Reads the vehicle poses: a time stamp and a 3x4 matrix per line. Adds a note if the
/// vehicle does not drive along x: then the axes are probably wrong.
PoseTrack read_mulran_poses(const fs::path& pose_file, const read::StampedLog& stamped, Notes& notes) {
    PoseTrack track;
    constexpr std::size_t kMatrixNumbers = 12;
    for (const read::PoseRow& row : read::read_stamped_rows(pose_file, kMatrixNumbers))
        track.append(stamped.seconds_of(row.stamp), make_pose(row.values, row.where));
    const glm::dvec3 driven = read::driving_direction(track).mean;
    if (driven != glm::dvec3(0.0) && driven.x < kMinForwardMotion)
        notes.push_back(fmt::format(
            "poses: on average, the vehicle drives in the direction ({:.2f}, {:.2f}, {:.2f}) of the vehicle "
            "frame, expected nearly (1, 0, 0); use dataset.poses=none to estimate the poses from the scans",
            driven.x, driven.y, driven.z));
    return track;
}

/// Returns the pose of the LiDAR on the vehicle. Rotates the published LiDAR frame by 180
/// degrees, so that x points forward.
Pose lidar_mount() {
    const auto rad = [](double degrees) { return degrees * kPi / 180.0; };
    const Pose base_from_ouster{make_rotation(rad(kAngles_deg[2]), rad(kAngles_deg[1]), rad(kAngles_deg[0])),
                                {kLidarPosition_m[0], kLidarPosition_m[1], kLidarPosition_m[2]}};
    return base_from_ouster * Pose{make_rotation(kPi, 0.0, 0.0), {}};
}

/// Returns how to read the scan files, with notes. The files have neither times nor
/// rings, so the format has a function that computes both from the order of the points.
read::FileFormat make_point_format(Log& log, const std::vector<fs::path>& scan_files) {
    read::FileFormat format;
    read::set_intensity_max(format, log, scan_files);
    format.sweep_duration_s = kRevolution_s;
    format.turned_rad = kPi;  // x points backward in the files, and forward in relidar
    const MulranPointOrder order = detect_order(scan_files);
    log.notes.push_back(
        "the points have no times; relidar computes the times from the order of the points in the file; the "
        "stamp of a file is the middle of its sweep");
    format.complete = [order](read::PointTable& table, const std::string& location) {
        add_ring_times(table, order, location);
    };
    return format;
}

}  // namespace

/// Loads a MulRan sequence: vehicle poses and the scans of an OS1-64.
Log load_mulran(const fs::path& log_folder, const DatasetOptions& options) {
    require_folder(log_folder, "a MulRan sequence (Ouster/ or sensor_data/Ouster/, global_pose.csv)");
    const fs::path folder = fs::canonical(log_folder);
    Log log;
    log.name = "MulRan " + folder.filename().string();
    log.source = log_folder.string();
    log.notes = {"this log has no labels"};
    log.conventions =
        "Frames of vehicle and LiDAR: x forward, y left, z up, in metres (in MulRan's files, the LiDAR's x "
        "axis points backward). Times are seconds after the first scan. The time of a frame is the middle of "
        "its sweep. Points are not motion-compensated. The world frame is that of global_pose.csv.";
    fs::path scans_folder = folder / "Ouster";
    if (!does_path_exist(scans_folder)) scans_folder = folder / "sensor_data/Ouster";
    if (!does_path_exist(scans_folder))
        fail(
            "{} contains neither Ouster/ nor sensor_data/Ouster/, expected the scans of the LiDAR in one of "
            "them",
            folder.string());
    read::StampedLog stamped{.unit_s = kNanosecond,
                             .scans = read::list_stamped_files(scans_folder),
                             .world_from_vehicle = {},
                             .poses_file = folder / "global_pose.csv",
                             .most_gap_s = kMostGap_s,
                             .pose_margin_s = 0.5 * kRevolution_s};  // the stamp is the middle of a sweep
    read::check_pose_source(stamped.poses_file, options);
    if (options.poses_file.empty())
        stamped.world_from_vehicle = read_mulran_poses(stamped.poses_file, stamped, log.notes);
    Lidar& lidar = log.lidars[0];
    lidar.vehicle_from_sensor = lidar_mount();
    lidar.sensor.name = "OS1-64 fitted to " + log.name;
    lidar.sensor.max_range_m = options.max_range_m;
    const std::vector<fs::path> files = read::add_frames(log, stamped, options);
    read::read_frame_scans(log, files, make_point_format(log, files), options);
    if (options.poses_file.empty()) {
        // Corrects the rays with all 100 poses per second, not only those at the frames.
        const PoseTrack track = shift_track(stamped.world_from_vehicle, -log.world_offset_m);
        // Scans without a pose were skipped, so `track` has a pose at each time.
        const auto pose_at = [&](double t_s) { return std::optional(track.pose_at(t_s)); };
        if (std::string note = read::correct_rays(log, pose_at); !note.empty())
            log.notes.push_back(std::move(note));
    }
    return log;
}

}  // namespace relidar
