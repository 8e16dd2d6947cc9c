// SPDX-License-Identifier: Apache-2.0
// Assigns points to the rays that measured them. aim_beam() gives the ray of a
// beam at head azimuth theta. The range is |point - origin|. The firing time is the
// measured time. If the points have no times, it is
//   -theta / (2 pi) * period   (clockwise, 0 = facing forward)
#include <relidar/read/clouds.hpp>

#include <algorithm>
#include <cmath>

#include "base/fail.hpp"
#include "log/sensor/beam_geometry.hpp"
#include "read/files/dropped_ray.hpp"

namespace relidar {
namespace {

constexpr int kNoIndex = -1;            // no point, or no firing
constexpr int kMostTicks = 1 << 16;     // maximum number of azimuth steps per sweep (0.005 degrees per step)
constexpr double kLeastRange_m = 1e-3;  // A point nearer to the origin has no defined direction.

/// Returns 0 for the first return of a ray.
std::size_t return_index_of(const LidarPoints& points, std::size_t point_index) {
    return points.return_number.empty() ? 0 : std::size_t(points.return_number[point_index]) - 1;
}

/// Throws unless all arrays have one entry per point and the ring numbers are valid.
/// @param n_beams  number of beams; 0 if rings are not needed
void check_points(const LidarPoints& points, std::size_t n_beams) {
    const auto check_size = [&](const char* field, std::size_t size) {
        if (size != points.size())
            fail<UsageError>(
                "cannot make a scan: found {} values of {} for the points, expected {}, one for each point",
                size, field, points.size());
    };
    const auto check_optional = [&](const char* field, std::size_t size) {
        if (size != 0) check_size(field, size);
    };
    check_size("intensity", points.intensity.size());
    if (n_beams > 0) check_size("ring", points.ring.size());
    else check_optional("ring", points.ring.size());
    check_optional("time_offset_s", points.time_offset_s.size());
    check_optional("return_number", points.return_number.size());
    check_optional("firing", points.firing.size());
    check_optional("classes", points.classes.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
        if (n_beams > 0 && points.ring[i] >= n_beams)
            fail<UsageError>(
                "cannot make a scan: point {} has ring {}, expected the index of one of {} beams", i,
                points.ring[i], n_beams);
        if (return_index_of(points, i) >= kMostReturns)
            fail<UsageError>("cannot make a scan: point {} has return number {}, expected 1 to {}", i,
                             points.return_number[i], kMostReturns);
    }
}

/// Returns for each azimuth step of the head (tick) the index of the nearest firing.
/// @param firing_ticks  [firings]
std::vector<int> firing_per_tick(const std::vector<int>& firing_ticks, int n_ticks) {
    std::vector<int> firing_at(std::size_t(n_ticks), kNoIndex);
    for (std::size_t f = 0; f < firing_ticks.size(); ++f) firing_at[std::size_t(firing_ticks[f])] = int(f);
    std::vector<int> nearest = firing_at;
    for (int tick = 0; tick < n_ticks; ++tick) {
        int& firing = nearest[std::size_t(tick)];
        for (int distance = 1; firing == kNoIndex && distance < n_ticks; ++distance) {
            const int below = (tick - distance + n_ticks) % n_ticks, above = (tick + distance) % n_ticks;
            firing = firing_at[std::size_t(below)];
            if (firing == kNoIndex) firing = firing_at[std::size_t(above)];
        }
    }
    return nearest;
}

/// Returns for each column of a scan the index of its firing (one shot of all lasers at
/// one azimuth). If there are fewer firings than columns, some get several columns.
std::vector<int> firing_per_column(const SweepFirings& sweep, int n_columns) {
    const std::size_t n = sweep.firings.size();
    std::vector<int> n_columns_of(n, 1);       // [firings]
    int n_extra_columns = n_columns - int(n);  // columns that still need a firing
    const double step_rad = 2.0 * kPi / n_columns;
    for (std::size_t f = 0; f + 1 < n && n_extra_columns > 0; ++f) {
        const double gap_rad = sweep.lattice.tick_azimuth_rad(sweep.firings[f]) -
                               sweep.lattice.tick_azimuth_rad(sweep.firings[f + 1]);
        // Azimuths decrease. Repeats the firing before a gap, where firings are missing.
        const int n_missing = std::min(int(std::lround(gap_rad / step_rad)) - 1, n_extra_columns);
        if (n_missing > 0) {
            n_columns_of[f] += n_missing;
            n_extra_columns -= n_missing;
        }
    }
    n_columns_of.back() += std::max(n_extra_columns, 0);
    std::vector<int> firing_of_column;
    for (std::size_t f = 0; f < n; ++f)
        firing_of_column.insert(firing_of_column.end(), std::size_t(n_columns_of[f]), int(f));
    firing_of_column.resize(std::size_t(n_columns));  // leaves out firings for which no column is left
    return firing_of_column;
}

/// Assigns points to rays. First, second and later returns have separate images.
class PointToRayAssignment {
public:
    /// Assigns all points.
    /// @param head_rad  [points] azimuth of the head at the time of the point
    PointToRayAssignment(const LidarPoints& points, const SpinningSensor& sensor, const SweepFirings& sweep,
                         const std::vector<double>& head_rad)
        : points_(points), sensor_(sensor), sweep_(sweep), head_rad_(head_rad) {
        firing_of.reserve(points.size());
        column_of_.reserve(points.size());
        if (points.firing.empty()) nearest_ = firing_per_tick(sweep.firings, sweep.lattice.n_ticks);
        by_return.emplace_back(n_rays(), kNoIndex);
        // Assigns far points last, so that they do not take the ray of a valid point.
        for (std::size_t i = 0; i < points.size(); ++i) assign_point(i);
        for (std::size_t i = 0; i < points.size(); ++i) assign_far_point(i);
    }
    /// [returns per ray][rings x firings] index of the point, or kNoIndex
    std::vector<std::vector<int>> by_return;
    /// [points] firing that measured the point; kNoIndex: the point is too near or far
    std::vector<int> firing_of;

private:
    std::vector<int> column_of_;  ///< [points] firing whose ray has the point; kNoIndex: no ray

    const LidarPoints& points_;
    const SpinningSensor& sensor_;
    const SweepFirings& sweep_;
    const std::vector<double>& head_rad_;
    /// [azimuth steps] nearest firing; empty if each point has a firing index
    std::vector<int> nearest_;

    std::size_t n_rays() const { return sensor_.beams.size() * sweep_.firings.size(); }

    float point_range_m(std::size_t point_index) const {
        return glm::length(points_.position_m[point_index]);
    }

    /// Returns the place for the index of the point with this return number of a ray.
    int& point_of_ray(std::size_t return_index, std::size_t ring, std::size_t firing) {
        while (by_return.size() <= return_index) by_return.emplace_back(n_rays(), kNoIndex);
        return by_return[return_index][ring * sweep_.firings.size() + firing];
    }

    std::size_t nearest_firing(std::size_t point_index) const {
        if (!points_.firing.empty()) return points_.firing[point_index];
        return std::size_t(nearest_[std::size_t(sweep_.lattice.nearest_tick(head_rad_[point_index]))]);
    }

    /// Returns true if a point is the next return of the ray of the point before it.
    bool is_next_return(std::size_t i) const {
        if (i == 0 || return_index_of(points_, i) != return_index_of(points_, i - 1) + 1) return false;
        const bool has_same_time =
            points_.time_offset_s.empty() || points_.time_offset_s[i] == points_.time_offset_s[i - 1];
        return points_.ring[i] == points_.ring[i - 1] && has_same_time;
    }

    /// Assigns a point to a ray (ring and firing), which stores only one point of each
    /// return number. The measured firing of the point is kept in `firing_of`, even if
    /// its ray is that of a neighbouring firing, or of a nearer point.
    void assign_point(std::size_t point_index) {
        const std::size_t ring = points_.ring[point_index], n_firings = sweep_.firings.size();
        const std::size_t return_index = return_index_of(points_, point_index);
        firing_of.push_back(kNoIndex);
        column_of_.push_back(kNoIndex);
        const double range_m = point_range_m(point_index);
        if (range_m > sensor_.max_range_m || range_m < kLeastRange_m) return;
        // The azimuths of returns can differ, because beams start beside the centre.
        const bool shares_firing =
            points_.firing.empty() && is_next_return(point_index) && column_of_[point_index - 1] != kNoIndex;
        const std::size_t firing =
            shares_firing ? std::size_t(column_of_[point_index - 1]) : nearest_firing(point_index);
        firing_of.back() = int(firing);

        // If the ray of a first return is occupied, tries the same ring in the two
        // neighbouring firings. A later return stays with its measured firing.
        for (const std::size_t f : {firing, (firing + 1) % n_firings, (firing + n_firings - 1) % n_firings}) {
            int& point = point_of_ray(return_index, ring, f);
            if (point != kNoIndex || (return_index > 0 && f != firing)) continue;
            point = int(point_index);
            column_of_.back() = int(f);
            return;
        }
        int& occupant = point_of_ray(return_index, ring, firing);
        if (range_m < double(point_range_m(std::size_t(occupant)))) {
            occupant = int(point_index);
            column_of_.back() = int(firing);
        }
    }

    /// Assigns a point beyond the maximum range to its ray, if the ray has no point yet.
    void assign_far_point(std::size_t point_index) {
        if (!(double(point_range_m(point_index)) > sensor_.max_range_m)) return;
        int& point = point_of_ray(return_index_of(points_, point_index), points_.ring[point_index],
                                  nearest_firing(point_index));
        if (point == kNoIndex) point = int(point_index);
    }
};

/// Returns the nearest firing with points, before or after firing f. Returns f if no
/// firing has points.
/// @param n_points  [firings]
std::size_t nearest_with_points(const std::vector<double>& n_points, std::size_t f) {
    const std::size_t n = n_points.size();
    for (std::size_t distance = 0; distance < n; ++distance) {
        if (f + distance < n && n_points[f + distance] > 0.0) return f + distance;
        if (f >= distance && n_points[f - distance] > 0.0) return f - distance;
    }
    return f;
}

/// Returns the mean time of the points of each firing. For a firing without points,
/// extrapolates from the nearest firing with points at the rotation rate of the head.
/// Without any times, the head faces forward at time 0.
std::vector<double> firing_times(const LidarPoints& points, const SpinningSensor& sensor,
                                 const SweepFirings& sweep, const std::vector<int>& firing_of_point) {
    const std::size_t n = sweep.firings.size();
    const auto azimuth_of = [&](std::size_t f) { return sweep.lattice.tick_azimuth_rad(sweep.firings[f]); };
    const auto turning_time_s = [&](double azimuth_rad) {  // of the head, from azimuth 0
        return (sensor.clockwise ? -azimuth_rad : azimuth_rad) / (2.0 * kPi) * sensor.period_s;
    };
    std::vector<double> sum_s(n, 0.0), n_points(n, 0.0);
    for (std::size_t i = 0; i < points.time_offset_s.size(); ++i)
        if (firing_of_point[i] != kNoIndex) {
            sum_s[std::size_t(firing_of_point[i])] += double(points.time_offset_s[i]);
            n_points[std::size_t(firing_of_point[i])] += 1.0;
        }
    std::vector<double> time_s(n);
    for (std::size_t f = 0; f < n; ++f) {
        const std::size_t from = nearest_with_points(n_points, f);
        if (n_points[from] == 0.0) {
            time_s[f] = turning_time_s(azimuth_of(f));
            continue;
        }
        const double step_rad = std::remainder(azimuth_of(f) - azimuth_of(from), 2.0 * kPi);
        time_s[f] = sum_s[from] / n_points[from] + turning_time_s(step_rad);
    }
    return time_s;
}

/// Resizes all arrays of a scan. Rays start at the sensor origin and have no returns.
void resize_scan(Scan& scan, int rows, int columns, std::size_t n_second_returns, bool has_classes) {
    const std::size_t n = std::size_t(rows) * std::size_t(columns);
    scan.rays.rows = rows;
    scan.rays.columns = columns;
    scan.rays.origin.assign(n, glm::vec3(0.0f));
    scan.rays.direction.resize(n);
    scan.rays.time_offset_s.resize(n);
    scan.rays.channel.resize(n);
    scan.range_m.assign(n, 0.0f);
    scan.intensity.assign(n, 0.0f);
    scan.second_returns.assign(n_second_returns, {std::vector<float>(n, 0.0f), std::vector<float>(n, 0.0f)});
    scan.classes.assign(has_classes ? n : 0, SurfaceClass::unknown);
}

/// Sets the values of a ray with a return. Its direction is from the beam's origin to the
/// point. Returns false and sets nothing if the point is too close to the origin.
/// @param head_azimuth_rad  azimuth of the head at the time of the point. It gives the
/// exact origin, even if the azimuths of the firings are rounded.
bool set_ray(Scan& scan, std::size_t ray, const BeamRays& beam, double head_azimuth_rad,
             const LidarPoints& points, std::size_t point_index) {
    const glm::dvec3 p(points.position_m[point_index]);
    const glm::dvec3 origin = beam.compute_ray(head_azimuth_rad).origin_m;
    const double range = glm::length(p - origin);
    if (!(range > kLeastRange_m)) return false;
    scan.rays.origin[ray] = glm::vec3(origin);
    scan.rays.direction[ray] = glm::vec3((p - origin) / range);
    scan.range_m[ray] = float(range);
    scan.intensity[ray] = glm::clamp(points.intensity[point_index], 0.0f, 1.0f);
    if (!points.time_offset_s.empty()) scan.rays.time_offset_s[ray] = points.time_offset_s[point_index];
    if (!points.classes.empty()) scan.classes[ray] = points.classes[point_index];
    return true;
}

/// Throws if the number of rays is invalid, or if the sweep lacks the firing of a point.
void check_sweep(const LidarPoints& points, const SpinningSensor& sensor, const SweepFirings& sweep) {
    if (sensor.columns < 1 || sensor.beams.size() * std::size_t(sensor.columns) > kMaxRays ||
        sweep.lattice.n_ticks > kMostTicks)
        fail<UsageError>(
            "cannot make a scan: found {} beams, {} columns and {} azimuth steps, expected 1 to {} rays and "
            "at most {} steps",
            sensor.beams.size(), sensor.columns, sweep.lattice.n_ticks, kMaxRays, kMostTicks);
    if (sweep.firings.empty())
        fail<UsageError>("cannot make a scan of {} points: found no firing, expected at least one",
                         points.size());
    for (const std::uint32_t firing : points.firing)
        if (firing >= sweep.firings.size())
            fail<UsageError>(
                "cannot make a scan: a point has firing {}, expected the index of one of {} firings", firing,
                sweep.firings.size());
}

/// Adds a second or later return of a ray, if the ray has a first return.
void set_second(Scan& scan, std::size_t ray, const LidarPoints& points, std::size_t point_index) {
    if (scan.range_m[ray] == 0.0f) return;
    AdditionalReturns& echo = scan.second_returns[return_index_of(points, point_index) - 1];
    echo.range_m[ray] = glm::distance(points.position_m[point_index], scan.rays.origin[ray]);
    echo.intensity[ray] = glm::clamp(points.intensity[point_index], 0.0f, 1.0f);
}

}  // namespace

Scan spinning_scan(const LidarPoints& points, const SpinningSensor& sensor, const SweepFirings& firings) {
    check_points(points, sensor.beams.size());
    check_sweep(points, sensor, firings);
    const std::vector<BeamRays> beams = make_generators(sensor.beams);
    std::vector<double> head_rad(points.size());
    for (std::size_t i = 0; i < points.size(); ++i)
        head_rad[i] = beams[points.ring[i]].azimuth_facing(glm::dvec3(points.position_m[i]));
    const PointToRayAssignment assigned(points, sensor, firings, head_rad);
    const std::vector<double> firing_time_s = firing_times(points, sensor, firings, assigned.firing_of);
    std::vector<double> firing_rad;
    for (const int tick : firings.firings) firing_rad.push_back(firings.lattice.tick_azimuth_rad(tick));

    const int n_columns = sensor.columns;
    const std::vector<int> firing_of_column = firing_per_column(firings, n_columns);
    Scan scan;
    resize_scan(scan, int(sensor.beams.size()), n_columns, assigned.by_return.size() - 1,
                !points.classes.empty());
    scan.rays.divergence_rad = float(sensor.divergence_rad);
    std::size_t ray = 0;  // ring * n_columns + column
    for (std::size_t ring = 0; ring < sensor.beams.size(); ++ring) {
        // Firing f of a beam with an azimuth offset is stored in column f - `shift`.
        const int shift = offset_columns(sensor.beams[ring], n_columns);
        for (int column = 0; column < n_columns; ++column, ++ray) {
            const int shifted = ((column + shift) % n_columns + n_columns) % n_columns;
            const auto firing = std::size_t(firing_of_column[std::size_t(shifted)]);
            scan.rays.time_offset_s[ray] = float(firing_time_s[firing]);
            scan.rays.channel[ray] = std::uint16_t(ring);
            const std::size_t fired_ray = ring * firings.firings.size() + firing;
            const int first = assigned.by_return[0][fired_ray];
            const bool has_return =
                first != kNoIndex &&
                set_ray(scan, ray, beams[ring], head_rad[std::size_t(first)], points, std::size_t(first));
            if (!has_return) {
                // A dropped ray is that of the ideal beam, and its range stays 0.
                const BeamRay ideal = beams[ring].compute_ray(firing_rad[firing]);
                scan.rays.origin[ray] = glm::vec3(ideal.origin_m);
                scan.rays.direction[ray] = glm::vec3(ideal.direction);
            }
            for (std::size_t later = 1; later < assigned.by_return.size(); ++later) {
                const int point = assigned.by_return[later][fired_ray];
                if (point != kNoIndex) set_second(scan, ray, points, std::size_t(point));
            }
        }
    }
    return scan;
}

Scan scan_of_points(const LidarPoints& points) {
    check_points(points, 0);
    if (points.size() > kMaxRays)
        fail<UsageError>("cannot make a scan: found {} points, expected at most {}", points.size(), kMaxRays);
    std::vector<std::size_t> first_returns;  // [rays] index of the point
    std::size_t n_second_returns = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        n_second_returns = std::max(n_second_returns, return_index_of(points, i));
        if (return_index_of(points, i) == 0 && glm::length(points.position_m[i]) > float(kLeastRange_m))
            first_returns.push_back(i);
    }
    Scan scan;
    resize_scan(scan, 1, int(first_returns.size()), n_second_returns, !points.classes.empty());
    for (std::size_t ray = 0; ray < first_returns.size(); ++ray) {
        const std::size_t i = first_returns[ray];
        scan.rays.direction[ray] = glm::vec3(glm::normalize(glm::dvec3(points.position_m[i])));
        // Missing times and rings become 0.
        scan.rays.time_offset_s[ray] = points.time_offset_s.empty() ? 0.0f : points.time_offset_s[i];
        scan.rays.channel[ray] = points.ring.empty() ? std::uint16_t(0) : points.ring[i];
        scan.range_m[ray] = glm::length(points.position_m[i]);
        scan.intensity[ray] = glm::clamp(points.intensity[i], 0.0f, 1.0f);
        if (!points.classes.empty()) scan.classes[ray] = points.classes[i];
        // Further returns of the ray directly follow its first return.
        for (std::size_t k = i + 1; k < points.size() && return_index_of(points, k) > 0; ++k)
            set_second(scan, ray, points, k);
    }
    return scan;
}

void undo_deskew(LidarPoints& points, const PoseTrack& world_from_sensor, double compensated_time_s) {
    const Pose world_from_reference = world_from_sensor.pose_at(compensated_time_s);
    for (std::size_t i = 0; i < points.size(); ++i) {
        const Pose world_from_firing =
            world_from_sensor.pose_at(compensated_time_s + double(points.time_offset_s[i]));
        points.position_m[i] =
            glm::vec3(inverse(world_from_firing) * (world_from_reference * glm::dvec3(points.position_m[i])));
    }
}

}  // namespace relidar
