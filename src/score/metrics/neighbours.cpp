// SPDX-License-Identifier: Apache-2.0
// Computes a baseline for rendering. Moves the two neighbouring real scans into another
// sweep, and projects their points into the image of that sweep. The baseline has no
// model of surfaces and does not fill holes. If the sensor hardly moves, the baseline is
// close to the real scan.
#include <relidar/score/metrics.hpp>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>
#include <set>

#include <relidar/log/log.hpp>

#include "base/fail.hpp"

namespace relidar {
namespace {

// on each side, because the column of an azimuth can be wrong by 2.8 (HDL-64E)
constexpr int kColumnSearch = 4;

/// Returns the nearest training frames of the same LiDAR before and after a frame.
/// Returns only one if the other does not exist.
std::vector<int> find_neighbours(const Log& log, int frame_index, const std::vector<int>& train_frames) {
    const auto lidar_of = [&](int position) { return log.frames[std::size_t(position)].lidar; };
    std::set<int> others;  // in order of time, like the frames of the log
    for (const int position : train_frames)
        if (position != frame_index && lidar_of(position) == lidar_of(frame_index)) others.insert(position);
    const auto after = others.lower_bound(frame_index);
    std::vector<int> neighbours;
    if (after != others.begin()) neighbours.push_back(*std::prev(after));
    if (after != others.end()) neighbours.push_back(*after);
    if (neighbours.empty())
        fail(
            "cannot project neighbouring scans into frame {}: the log has no other training frame of the "
            "same LiDAR, expected at least one",
            log.frames[std::size_t(frame_index)].index);
    return neighbours;
}

/// Converts a point from the world frame to the sensor frame at the time when the
/// rotating LiDAR faces the point. This time depends on the direction of the point, which
/// is first computed with the sensor pose at the reference time of the sweep.
glm::dvec3 world_to_sensor(const Log& log, const glm::dvec3& world_point_m, const Frame& frame) {
    const Pose& mounted = log.lidar_of(frame).vehicle_from_sensor;
    const glm::dvec3 at_reference =
        inverse(log.world_from_vehicle.mounted_pose_at(frame.time_s, mounted)) * world_point_m;
    const double facing_s = facing_time_s(log, at_reference, timing_of(frame));
    return inverse(log.world_from_vehicle.mounted_pose_at(facing_s, mounted)) * world_point_m;
}

/// Adds a return at a point. The ray starts at the origin, with time and row 0.
void append_point(Scan& scan, const glm::dvec3& sensor_point_m, float intensity) {
    const double range_m = glm::length(sensor_point_m);
    if (!(range_m > 0.0)) return;
    scan.rays.origin.emplace_back(0.0f);
    scan.rays.direction.emplace_back(sensor_point_m / range_m);
    scan.rays.time_offset_s.push_back(0.0f);
    scan.rays.channel.push_back(0);
    scan.range_m.push_back(float(range_m));
    scan.intensity.push_back(intensity);
}

struct RayPixel {
    int row = 0, column = 0;
};

double elevation_rad(const glm::dvec3& vector) {
    return std::asin(std::clamp(vector.z / glm::length(vector), -1.0, 1.0));
}

/// In double precision, because in single the cosine of 0.02 degrees is 1.
struct RayTableNeighbours {
    const RayTable& rays;
    const bool circular = is_full_turn(rays.rows, rays.columns, rays.direction);

    /// Columns wrap around in a full turn. Otherwise they end at the first and last one.
    std::size_t ray_index(RayPixel ray_cell) const {
        const int wrapped = circular ? (ray_cell.column % rays.columns + rays.columns) % rays.columns
                                     : std::clamp(ray_cell.column, 0, rays.columns - 1);
        return std::size_t(ray_cell.row) * std::size_t(rays.columns) + std::size_t(wrapped);
    }
    double azimuth_rad_from(const glm::dvec3& direction, RayPixel ray_cell) const {
        const glm::dvec3 ray = ray_direction(ray_cell);
        return std::remainder(std::atan2(direction.y, direction.x) - std::atan2(ray.y, ray.x), 2.0 * kPi);
    }
    /// Returns the azimuth of a point in units of the columns of a row. Columns have even
    /// steps. Rows differ, because beams have azimuth offsets.
    double estimate_column(const glm::dvec3& point_m, int row) const {
        // Measures the azimuth step of a column over the middle quarter of the row: over
        // half a turn, the sign of the difference would be ambiguous.
        const int first = 3 * rays.columns / 8, last = 5 * rays.columns / 8;
        const double step_rad = azimuth_rad_from(ray_direction({row, last}), {row, first}) / (last - first);
        return rays.columns / 2 + azimuth_rad_from(point_m, {row, rays.columns / 2}) / step_rad;
    }
    glm::dvec3 vector_from_origin(RayPixel ray_cell, const glm::vec3& point_m) const {
        return glm::dvec3(point_m) - glm::dvec3(rays.origin[ray_index(ray_cell)]);
    }
    glm::dvec3 ray_direction(RayPixel ray_cell) const { return rays.direction[ray_index(ray_cell)]; }
    double elevation_above_rad(RayPixel ray_cell, const glm::vec3& point_m) const {
        return elevation_rad(vector_from_origin(ray_cell, point_m)) - elevation_rad(ray_direction(ray_cell));
    }
    double cosine_to(RayPixel ray_cell, const glm::vec3& point_m) const {
        const glm::dvec3 v = vector_from_origin(ray_cell, point_m);
        return glm::dot(v, ray_direction(ray_cell)) / glm::length(v);
    }
    /// Returns the ray with the smallest angle to a point. Finds the row with the nearest
    /// elevation first. Then compares a few rays around it, because beams have different
    /// azimuth offsets.
    RayPixel find_nearest(const glm::vec3& point_m) const {
        // Rows are compared at the column that faces the point in the middle row.
        int column = int(std::lround(estimate_column(point_m, rays.rows / 2)));
        int row = 0;
        double least_rad = std::abs(elevation_above_rad({0, column}, point_m));
        for (int r = 1; r < rays.rows; ++r)
            if (const double off_rad = std::abs(elevation_above_rad({r, column}, point_m));
                off_rad < least_rad) {
                least_rad = off_rad;
                row = r;
            }
        RayPixel best_ray{row, column};
        double best_cosine = cosine_to(best_ray, point_m);
        for (int r = std::max(row - 1, 0); r <= std::min(row + 1, rays.rows - 1); ++r) {
            column = int(std::lround(estimate_column(point_m, r)));
            for (int c = column - kColumnSearch; c <= column + kColumnSearch; ++c)
                if (const double cosine = cosine_to({r, c}, point_m); cosine > best_cosine) {
                    best_cosine = cosine;
                    best_ray = {r, c};
                }
        }
        return best_ray;
    }
    /// Returns true if a point is outside the outer rows, or outside the outer columns of
    /// less than a full turn. The distance must be more than half their spacing.
    bool is_outside(RayPixel ray_cell, const glm::vec3& point_m) const {
        const double column = estimate_column(point_m, ray_cell.row);
        if (!circular && (column < -0.5 || column > rays.columns - 0.5)) return true;
        const double half_spacing =
            0.5 * std::abs(elevation_rad(ray_direction(ray_cell)) -
                           elevation_rad(
                               ray_direction({ray_cell.row == 0 ? 1 : ray_cell.row - 1, ray_cell.column})));
        return (ray_cell.row == 0 && elevation_above_rad(ray_cell, point_m) > half_spacing) ||
               (ray_cell.row == rays.rows - 1 && elevation_above_rad(ray_cell, point_m) < -half_spacing);
    }
};

/// Returns the position of a point at another time. A point in a moving box moves with
/// the box, and all other points stand still.
/// @return nothing if the box is not observed at the time `then_s`
std::optional<glm::dvec3> follow_box(const WorldReturn& point, const std::vector<const BoxTrack*>& boxes,
                                     double then_s) {
    const auto contains_point = [&](const BoxTrack* box) {
        return box->is_observed(point.time_s) && box->contains_point(point.point_m, point.time_s, 0.0);
    };
    const auto match = std::ranges::find_if(boxes, contains_point);
    if (match == boxes.end()) return point.point_m;
    const BoxTrack& box = **match;
    if (!box.is_observed(then_s)) return std::nullopt;
    return box.world_from_box.pose_at(then_s) *
           (inverse(box.world_from_box.pose_at(point.time_s)) * point.point_m);
}

/// Adds the returns of a frame to `points`, where another sweep of the same LiDAR would
/// measure them.
/// @param moving  boxes with which points move
void append_returns(Scan& points, const Log& log, const Frame& frame, const Frame& sweep,
                    const std::vector<const BoxTrack*>& moving) {
    for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
        const float measured_m = frame.scan.range_m[ray];
        if (!(measured_m > 0.0f)) continue;
        WorldReturn point = locate_return(log, frame, ray);
        // locate_return() has removed the range offset of the beam. Scores compare
        // measured ranges, so this adds it again.
        point.point_m += double(measured_m - surface_return(log, frame, ray).range_m) * point.direction;
        // The LiDAR faces about the same direction at the same time after the start of
        // each sweep. A box is at its position of this time.
        const double then_s = sweep.time_s + (point.time_s - frame.time_s);
        if (const std::optional<glm::dvec3> world_m = follow_box(point, moving, then_s))
            append_point(points, world_to_sensor(log, *world_m, sweep), frame.scan.intensity[ray]);
    }
}

}  // namespace

Scan predict_scan(const Log& log, int index, const std::vector<int>& train_frames, BoxPointMotion motion) {
    const Frame& sweep = log.frames.at(std::size_t(index));
    std::vector<const BoxTrack*> moving;
    for (const BoxTrack& box : log.boxes)
        if (motion == BoxPointMotion::follow && box.is_moving()) moving.push_back(&box);
    Scan points;
    for (const int neighbour : find_neighbours(log, index, train_frames))
        append_returns(points, log, log.frames.at(std::size_t(neighbour)), sweep, moving);
    points.rays.rows = 1;
    points.rays.columns = int(points.range_m.size());
    return points;
}

Scan assign_points(const RayTable& rays, const Scan& points) {
    // find_nearest() compares this number of columns; in a full turn, they wrap around.
    if (rays.rows < 2 || rays.columns < 2 * kColumnSearch + 1)
        fail(
            "cannot project points into an image of {} rows and {} columns, expected the rays of a spinning "
            "sensor with at least 2 rows and {} columns",
            rays.rows, rays.columns, 2 * kColumnSearch + 1);
    const RayTableNeighbours beams{rays};
    Scan scan{rays, ScanArray<float>(rays.size()), ScanArray<float>(rays.size())};
    for (std::size_t i = 0; i < points.range_m.size(); ++i) {
        const glm::vec3 point = points.return_point(i);
        const RayPixel ray_cell = beams.find_nearest(point);
        if (beams.is_outside(ray_cell, point)) continue;
        const std::size_t ray = beams.ray_index(ray_cell);
        const float range = glm::distance(point, rays.origin[ray]);
        // A ray keeps its nearest point.
        const bool has_nearer_point = scan.range_m[ray] > 0.0f && scan.range_m[ray] <= range;
        if (!(range > 0.0f) || has_nearer_point) continue;
        scan.range_m[ray] = range;
        scan.intensity[ray] = points.intensity[i];
    }
    return scan;
}

}  // namespace relidar
