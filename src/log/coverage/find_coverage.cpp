// SPDX-License-Identifier: Apache-2.0
// Computes which space the scans of a log have observed. Processes each scan column by
// column.
#include <relidar/log/coverage.hpp>

#include <algorithm>
#include <cmath>
#include <mutex>

#include "base/parallel.hpp"

namespace relidar {
namespace {

struct RaySegment {
    WorldRay ray;
    double length_m = 0.0;  ///< length of the observed path; 0 if the ray gives no information
};

/// Returns the observed length of each ray of a column, highest beam first. A dropped ray
/// has observed space only if a lower ray has a return: up to the nearer of the next
/// returns above and below, or up to max_range_m without a return above.
/// @param ranges_m  [rows] 0 if the ray was dropped
std::vector<double> observed_lengths_m(const std::vector<double>& ranges_m, double max_range_m) {
    const std::size_t n = ranges_m.size();
    std::vector<double> above(n, 0.0), result(n, 0.0);  // range of the nearest return above each row
    for (std::size_t row = 1; row < n; ++row)
        above[row] = ranges_m[row - 1] > 0.0 ? ranges_m[row - 1] : above[row - 1];
    double below = 0.0;
    for (std::size_t row = n; row-- > 0;) {
        if (ranges_m[row] > 0.0) below = result[row] = ranges_m[row];
        else if (below > 0.0) result[row] = above[row] > 0.0 ? std::min(above[row], below) : max_range_m;
    }
    return result;
}

/// Marks the space between two neighbouring rays as observed, up to the shorter ray.
/// Otherwise cells between diverging rays would stay unobserved.
void fill_between(ObservedVoxelSet& coverage, const RaySegment& first_ray, const RaySegment& second_ray) {
    const double length_m = std::min(first_ray.length_m, second_ray.length_m);
    const int n = int(length_m * glm::distance(first_ray.ray.direction, second_ray.ray.direction) /
                      ObservedVoxelSet::kCell_m);
    for (int k = 1; k <= n; ++k) {
        const double s = double(k) / (n + 1);
        const glm::dvec3 origin_m = glm::mix(first_ray.ray.origin_m, second_ray.ray.origin_m, s);
        coverage.add_segment(origin_m,
                             origin_m + length_m * glm::normalize(glm::mix(first_ray.ray.direction,
                                                                           second_ray.ray.direction, s)));
    }
}

ObservedVoxelSet observe_frame(const Log& sequence, const PoseTrack& world_from_sensor, const Frame& frame,
                               double max_range_m) {
    ObservedVoxelSet coverage;
    const Scan& scan = frame.scan;
    const std::size_t columns = std::size_t(std::max(scan.rays.columns, 1)),
                      rows = scan.range_m.size() / columns;
    // Uses only every `step`-th column, at most every 16th, because the columns in
    // between cross the same grid cells.
    std::size_t step = 1;
    if (rows > 1) {
        const int sensor_columns = sequence.lidar_of(frame).sensor.columns;
        const double step_m =
            sensor_columns > 0 ? 2.0 * kPi / sensor_columns * max_range_m : ObservedVoxelSet::kCell_m;
        step = std::size_t(std::clamp(ObservedVoxelSet::kCell_m / step_m, 1.0, 16.0));
    }
    std::vector<double> range_m(rows);
    std::vector<RaySegment> looks(rows);
    for (std::size_t column = 0; column < columns; column += step) {
        for (std::size_t row = 0; row < rows; ++row)
            range_m[row] = std::min(double(scan.range_m[row * columns + column]), max_range_m);
        const std::vector<double> length_m = observed_lengths_m(range_m, max_range_m);
        for (std::size_t row = 0; row < rows; ++row) {
            looks[row].length_m = length_m[row];
            if (!(length_m[row] > 0.0)) continue;
            looks[row].ray = make_world_ray(world_from_sensor, frame.time_s, scan.rays,
                                            row * columns + column, sequence.rolling_shutter);
            const WorldRay& ray = looks[row].ray;
            coverage.add_segment(ray.origin_m, ray.origin_m + length_m[row] * ray.direction);
            if (row > 0 && looks[row - 1].length_m > 0.0) fill_between(coverage, looks[row - 1], looks[row]);
        }
    }
    return coverage;
}

}  // namespace

ObservedVoxelSet observe_coverage(const Log& sequence, const PoseTrack& world_from_vehicle,
                                  const std::vector<int>& frame_indices, double max_range_m) {
    std::vector<PoseTrack> world_from_sensor;
    for (const Lidar& lidar : sequence.lidars)
        world_from_sensor.push_back(mount_track(world_from_vehicle, lidar.vehicle_from_sensor));
    ObservedVoxelSet all;
    std::mutex mutex;
    parallel_for(int(frame_indices.size()), [&](int index) {
        const Frame& frame = sequence.frames[std::size_t(frame_indices[std::size_t(index)])];
        const ObservedVoxelSet one =
            observe_frame(sequence, world_from_sensor[std::size_t(frame.lidar)], frame, max_range_m);
        const std::lock_guard lock(mutex);
        all.merge(one);
    });
    return all;
}

}  // namespace relidar
