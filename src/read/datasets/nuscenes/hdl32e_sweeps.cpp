// SPDX-License-Identifier: Apache-2.0
#include "read/datasets/nuscenes/hdl32e_sweeps.hpp"

#include <cmath>
#include <cstring>
#include <fstream>
#include <set>

#include <relidar/read/clouds.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/progress_blocks.hpp"
#include "read/scans/broken_scans.hpp"
#include "read/scans/fired_sweeps.hpp"
#include "read/scans/sweep_firings.hpp"

namespace relidar::nuscenes {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kBeams = 32, kPointBytes = 20;
constexpr double kPeriod_s = 0.05;
// Points nearer to the LiDAR than this are rays without a return.
constexpr double kNoReturn_m = 1.0;
constexpr double kFarthestOfSweep_m = 1e4;
constexpr std::size_t kMostColumnsOfSweep = 8192;

/// Removes rays without a return. The dataset stores them as points at the LiDAR, and
/// motion compensation has moved these points a little.
/// @param points  points in the frame of the LiDAR at the time of each point
/// @param column_of_point  [points] column of each point
void remove_dropped(LidarPoints& points, std::vector<int>& column_of_point) {
    std::vector<bool> is_dropped;
    for (const glm::vec3& p : points.position_m) is_dropped.push_back(double(glm::length(p)) < kNoReturn_m);
    const auto remove_from = [&](auto& values) {
        std::size_t point = 0;
        std::erase_if(values, [&](const auto&) { return is_dropped[point++]; });
    };
    remove_from(points.position_m);
    remove_from(points.intensity);
    remove_from(points.ring);
    remove_from(points.time_offset_s);
    remove_from(points.classes);
    remove_from(column_of_point);
}

/// Reads the category index of each point, one byte per point.
std::string read_categories(const fs::path& file, std::size_t n_points) {
    std::string categories = read_file(file);
    if (categories.size() != n_points)
        fail(
            "{} has {} bytes, expected one byte for each of the {} points of the sweep, with the category of "
            "the point",
            file.string(), categories.size(), n_points);
    return categories;
}

/// A point in a file. x points to the right, y forward, z up. Ring 0 is the lowest beam.
struct StoredPoint {
    float x, y, z, intensity, ring;
};
static_assert(sizeof(StoredPoint) == kPointBytes);

/// Reads point i of a file and checks its values.
StoredPoint read_point(const std::string& bytes, std::size_t i, const std::string& file) {
    StoredPoint p;
    std::memcpy(&p, bytes.data() + i * kPointBytes, kPointBytes);
    const double range_m = std::hypot(double(p.x), double(p.y), double(p.z));
    if (!(range_m < kFarthestOfSweep_m) || !std::isfinite(p.intensity))
        fail(
            "{}: point {} is ({}, {}, {}) with intensity {}, expected coordinates in metres of at most "
            "{}",
            file, i, p.x, p.y, p.z, p.intensity, kFarthestOfSweep_m);
    if (!(p.ring >= 0.0f && p.ring < float(kBeams)) || p.ring != std::floor(p.ring))
        fail("{}: point {} has ring {}, expected 0 to {}", file, i, p.ring, kBeams - 1);
    return p;
}

/// Reads a file with one revolution. The firing time of a point follows from its column,
/// because the file contains no times.
/// @param world_from_sensor  poses with which the dataset has moved the points
read::FiredSweep read_sweep(const SweepFiles& sweep_files,
                            const std::array<SurfaceClass, 256>& class_of_category,
                            const SpinningSensor& sensor, const PoseTrack& world_from_sensor,
                            double sweep_time_s) {
    const fs::path& file = sweep_files.points;
    const std::string bytes = read_file(file);
    if (bytes.empty() || bytes.size() % (kBeams * kPointBytes) != 0 ||
        bytes.size() / (kBeams * kPointBytes) > kMostColumnsOfSweep)
        fail(
            "{} has {} bytes, expected a multiple of {} bytes (a column of {} points with {} bytes each), "
            "and 1 to {} columns",
            file.string(), bytes.size(), kBeams * kPointBytes, kBeams, kPointBytes, kMostColumnsOfSweep);
    const std::size_t n = bytes.size() / kPointBytes, columns = n / kBeams;
    const std::string categories =
        sweep_files.categories.empty() ? "" : read_categories(sweep_files.categories, n);
    read::FiredSweep read;
    LidarPoints& points = read.points;
    std::vector<int> column_of_point;
    for (std::size_t i = 0; i < n; ++i) {
        const StoredPoint p = read_point(bytes, i, file.string());
        if (p.x == 0.0f && p.y == 0.0f && p.z == 0.0f) continue;
        const std::size_t column = i / kBeams;
        points.position_m.emplace_back(p.y, -p.x, p.z);
        points.intensity.push_back(p.intensity / 255.0f);
        // relidar numbers the beams from the highest one. Time 0 is the end of the sweep.
        points.ring.push_back(std::uint16_t(kBeams - 1 - std::size_t(p.ring)));
        points.time_offset_s.push_back(float(-kPeriod_s * (1.0 - double(column) / double(columns))));
        if (!categories.empty())
            points.classes.push_back(class_of_category[static_cast<unsigned char>(categories[i])]);
        column_of_point.push_back(int(column));
    }
    undo_deskew(points, world_from_sensor, sweep_time_s);
    remove_dropped(points, column_of_point);
    if (points.size() == 0)
        fail(
            "{} has no points at a distance of {} m or more, expected at least one; nearer points are read "
            "as rays without a return",
            file.string(), kNoReturn_m);
    // The head rotates clockwise by one column from firing to firing.
    read.sweep = arrange_firings(points, column_of_point, sensor, -2.0 * kPi / double(columns));
    return read;
}

}  // namespace

bool is_hdl32e_file(const fs::path& file) {
    StoredPoint column[kBeams];
    std::ifstream stream(file, std::ios::binary);
    // read_sweep() reports a file without a column.
    if (!stream.read(reinterpret_cast<char*>(column), sizeof column)) return true;
    std::set<float> rings;
    for (const StoredPoint& point : column) rings.insert(point.ring);
    return rings.size() == kBeams;
}

Lidar make_hdl32e(const Pose& ego_from_lidar) {
    SpinningSensor sensor;
    sensor.name = "HDL-32E";
    sensor.period_s = kPeriod_s;
    for (std::size_t row = 0; row < kBeams; ++row)
        // Nominal elevations of the HDL-32E: +10.67 to -30.67 degrees.
        sensor.beams.push_back({.elevation_rad = (32.0 - 4.0 * double(row)) / 3.0 * kPi / 180.0});
    // x (forward) in relidar is y in nuScenes, where x points to the right.
    const Pose nuscenes_from_relidar{glm::angleAxis(kPi / 2.0, glm::dvec3(0, 0, 1)), glm::dvec3(0.0)};
    return {"", sensor, ego_from_lidar * nuscenes_from_relidar};
}

void read_hdl32e_sweeps(Log& log, const std::vector<SweepFiles>& sweep_files,
                        const std::array<SurfaceClass, 256>& class_of_category,
                        const PoseTrack& vehicle_track, const DatasetOptions& options) {
    ScanErrorCollector broken(options.skip_broken);
    std::vector<PoseTrack> lidar_tracks;  // [lidars] poses of each LiDAR over time
    for (const Lidar& lidar : log.lidars)
        lidar_tracks.push_back(mount_track(vehicle_track, lidar.vehicle_from_sensor));
    std::vector<read::FiredSweep> sweeps(sweep_files.size());
    progress_for(sweeps.size(), options.progress, "reading sweeps", [&](std::size_t i) {
        const Frame& frame = log.frames[i];
        broken.guard(i, [&] {  // skips a broken sweep, or throws its error
            sweeps[i] = read_sweep(sweep_files[i], class_of_category, log.lidar_of(frame).sensor,
                                   lidar_tracks[std::size_t(frame.lidar)], frame.time_s);
        });
    });
    read::set_fired_scans(log, sweeps, options.progress);
    broken.remove_broken(log);
}

}  // namespace relidar::nuscenes
