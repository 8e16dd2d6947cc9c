// SPDX-License-Identifier: Apache-2.0
#include "read/datasets/nuscenes/hdl32e_sweeps.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <set>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
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
    std::size_t n = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        if (double(glm::length(points.position_m[i])) < kNoReturn_m) continue;
        points.position_m[n] = points.position_m[i];
        points.intensity[n] = points.intensity[i];
        points.ring[n] = points.ring[i];
        points.time_offset_s[n] = points.time_offset_s[i];
        if (!points.classes.empty()) points.classes[n] = points.classes[i];
        column_of_point[n++] = column_of_point[i];
    }
    points.position_m.resize(n);
    points.intensity.resize(n);
    points.ring.resize(n);
    points.time_offset_s.resize(n);
    column_of_point.resize(n);
    if (!points.classes.empty()) points.classes.resize(n);
}

std::string read_categories(const fs::path& file, std::size_t n_points) {
    std::string categories = read_file(file);
    if (categories.size() != n_points)
        fail(
            "{} has {} bytes, expected one byte for each of the {} points of the sweep, with the category of "
            "the point",
            file.string(), categories.size(), n_points);
    return categories;
}

/// Reads a file with one revolution. The firing time of a point follows from its column,
/// because the file contains no times.
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
    std::vector<int> numbers;
    for (std::size_t i = 0; i < n; ++i) {
        float v[5];  // x to the right, y forward, z up, intensity, ring
        std::memcpy(v, bytes.data() + i * kPointBytes, kPointBytes);
        const double range_m = std::hypot(double(v[0]), double(v[1]), double(v[2]));
        if (!(range_m < kFarthestOfSweep_m) || !std::isfinite(v[3]))
            fail(
                "{}: point {} is ({}, {}, {}) with intensity {}, expected coordinates in metres of at most "
                "{}",
                file.string(), i, v[0], v[1], v[2], v[3], kFarthestOfSweep_m);
        if (!(v[4] >= 0.0f && v[4] < float(kBeams)) || v[4] != std::floor(v[4]))
            fail("{}: point {} has ring {}, expected 0 to {}", file.string(), i, v[4], kBeams - 1);
        if (range_m == 0.0) continue;
        const std::size_t column = i / kBeams;
        read.points.position_m.emplace_back(v[1], -v[0], v[2]);
        read.points.intensity.push_back(v[3] / 255.0f);
        // Files number the beams from the lowest one, relidar from the highest one.
        read.points.ring.push_back(std::uint16_t(kBeams - 1 - std::size_t(v[4])));
        read.points.time_offset_s.push_back(float(-kPeriod_s * (1.0 - double(column) / double(columns))));
        if (!categories.empty())
            read.points.classes.push_back(class_of_category[static_cast<unsigned char>(categories[i])]);
        numbers.push_back(int(column));
    }
    undo_deskew(read.points, world_from_sensor, sweep_time_s);
    remove_dropped(read.points, numbers);
    if (read.points.size() == 0)
        fail(
            "{} has no points at a distance of {} m or more, expected at least one; nearer points are read "
            "as rays without a return",
            file.string(), kNoReturn_m);
    read.sweep = arrange_firings(read.points, numbers, sensor, -2.0 * kPi / double(columns));
    return read;
}

}  // namespace

bool is_hdl32e_file(const fs::path& file) {
    float column[kBeams][5];
    std::ifstream stream(file, std::ios::binary);
    // read_sweep() reports a file without a column.
    if (!stream.read(reinterpret_cast<char*>(column), sizeof column)) return true;
    std::set<float> rings;
    for (const auto& point : column) rings.insert(point[4]);
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
    const Pose theirs_from_ours{glm::angleAxis(kPi / 2.0, glm::dvec3(0, 0, 1)), glm::dvec3(0.0)};
    return {"", sensor, ego_from_lidar * theirs_from_ours};
}

void read_hdl32e_sweeps(Log& sequence, const std::vector<SweepFiles>& sweep_files,
                        const std::array<SurfaceClass, 256>& class_of_category,
                        const PoseTrack& vehicle_track, const DatasetOptions& options) {
    ScanErrorCollector broken(options.skip_broken);
    std::vector<PoseTrack> ways;  // [lidars] poses of each LiDAR over time
    for (const Lidar& lidar : sequence.lidars)
        ways.push_back(mount_track(vehicle_track, lidar.vehicle_from_sensor));
    std::vector<read::FiredSweep> sweeps(sweep_files.size());
    progress_for(sweeps.size(), options.progress, "reading sweeps", [&](std::size_t at) {
        const Frame& frame = sequence.frames[at];
        broken.guard(at, [&] {
            sweeps[at] = read_sweep(sweep_files[at], class_of_category, sequence.lidar_of(frame).sensor,
                                    ways[std::size_t(frame.lidar)], frame.time_s);
        });
    });
    read::set_fired_scans(sequence, sweeps, options.progress);
    broken.remove_broken(sequence);
}

}  // namespace relidar::nuscenes
