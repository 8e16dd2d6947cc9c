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

namespace relidar {
namespace {

constexpr int kNoPointIndex = -1;
// maximum number of returns per ray; real sensors have two or three
constexpr std::size_t kMostReturns = 8;
constexpr int kMostTicks = 1 << 16;     // maximum number of azimuth steps per sweep (0.005 degrees per step)
constexpr double kLeastRange_m = 1e-3;  // A point nearer to the origin has no defined direction.

/// [rings x firings] index of the point that is assigned to each ray; kNoPointIndex: no
/// return
struct RayPointIndices {
    std::size_t n_firings;
    std::vector<int> point;

    int& point_index_at(std::size_t ring, std::size_t firing) { return point[ring * n_firings + firing]; }
};

std::size_t return_index_of(const LidarPoints& points, std::size_t point_index) {
    return points.return_number.empty() ? 0 : std::size_t(points.return_number[point_index]) - 1;
}

/// Throws unless all arrays have one entry per point and the ring numbers are valid.
/// @param n_beams  number of beams; 0 if rings are not needed
void check_points(const LidarPoints& points, std::size_t n_beams) {
    const auto check = [&](const char* field, std::size_t count, bool may_be_empty) {
        if (count != points.size() && !(may_be_empty && count == 0))
            fail<UsageError>(
                "cannot make a scan: found {} values of {} for the points, expected {}, one for each point",
                count, field, points.size());
    };
    check("intensity", points.intensity.size(), false);
    check("ring", points.ring.size(), n_beams == 0);
    check("time_offset_s", points.time_offset_s.size(), true);
    check("return_number", points.return_number.size(), true);
    check("firing", points.firing.size(), true);
    check("classes", points.classes.size(), true);
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
std::vector<int> firing_per_tick(const std::vector<int>& firing_ticks, int n_ticks) {
    std::vector<int> nearest(std::size_t(n_ticks), kNoPointIndex);
    for (std::size_t f = 0; f < firing_ticks.size(); ++f) nearest[std::size_t(firing_ticks[f])] = int(f);
    std::vector<int> filled = nearest;
    for (int t = 0; t < n_ticks; ++t) {
        for (int d = 1; filled[std::size_t(t)] == kNoPointIndex && d < n_ticks; ++d) {
            const int below = nearest[std::size_t((t - d % n_ticks + n_ticks) % n_ticks)];
            filled[std::size_t(t)] = below != kNoPointIndex ? below : nearest[std::size_t((t + d) % n_ticks)];
        }
    }
    return filled;
}

/// Returns for each column of a scan the index of its firing (one shot of all lasers at
/// one azimuth). If the sweep has fewer firings than columns, several columns get the
/// same firing.
std::vector<int> firing_per_column(const SweepFirings& sweep, int n_columns) {
    const std::size_t n = sweep.firings.size();
    std::vector<int> repeat(n, 1);
    int n_extra_columns = n_columns - int(n);
    const double step = 2.0 * kPi / n_columns;
    for (std::size_t f = 0; f + 1 < n && n_extra_columns > 0; ++f) {
        const double gap = sweep.lattice.tick_azimuth_rad(sweep.firings[f]) -
                           sweep.lattice.tick_azimuth_rad(sweep.firings[f + 1]);
        // Repeats the firing before a gap in azimuth, where firings are missing.
        const int missing = std::min(int(std::lround(gap / step)) - 1, n_extra_columns);
        if (missing > 0) {
            repeat[f] += missing;
            n_extra_columns -= missing;
        }
    }
    repeat.back() += std::max(n_extra_columns, 0);
    std::vector<int> slot;
    for (std::size_t f = 0; f < n; ++f) slot.insert(slot.end(), std::size_t(repeat[f]), int(f));
    slot.resize(std::size_t(n_columns));
    return slot;
}

/// Assigns points to rays. First, second and later returns have separate images.
class PointToRayAssignment {
public:
    /// @param head_rad  [points] azimuth of the head at the time of the point
    PointToRayAssignment(const LidarPoints& points, const SpinningSensor& sensor, const SweepFirings& sweep,
                         const std::vector<double>& head_rad)
        : points_(points), sensor_(sensor), sweep_(sweep), head_rad_(head_rad) {
        firing_of.reserve(points.size());
        column_of_.reserve(points.size());
        if (points.firing.empty()) nearest_ = firing_per_tick(sweep.firings, sweep.lattice.n_ticks);
        indices_of_return(0);
        // Assigns far points last, so that they do not take the ray of a valid point.
        for (std::size_t i = 0; i < points.size(); ++i) assign_point(i);
        for (std::size_t i = 0; i < points.size(); ++i) assign_far_point(i);
    }
    std::vector<RayPointIndices> by_return;
    /// [points] firing that measured each point; kNoPointIndex if the point is too near
    /// or too far
    std::vector<int> firing_of;

private:
    std::vector<int> column_of_;  ///< [points] firing whose ray has the point; kNoPointIndex: no ray

    const LidarPoints& points_;
    const SpinningSensor& sensor_;
    const SweepFirings& sweep_;
    const std::vector<double>& head_rad_;
    /// [azimuth steps] nearest firing; empty if each point has a firing index
    std::vector<int> nearest_;

    float point_range_m(int point_index) const {
        return glm::length(points_.position_m[std::size_t(point_index)]);
    }

    RayPointIndices& indices_of_return(std::size_t return_index) {
        while (by_return.size() <= return_index)
            by_return.push_back(
                {sweep_.firings.size(),
                 std::vector<int>(sensor_.beams.size() * sweep_.firings.size(), kNoPointIndex)});
        return by_return[return_index];
    }

    std::size_t nearest_firing(std::size_t point_index) const {
        if (!points_.firing.empty()) return points_.firing[point_index];
        return std::size_t(nearest_[std::size_t(sweep_.lattice.nearest_tick(head_rad_[point_index]))]);
    }

    /// Returns the firing of the previous point if this point is the next return of its
    /// ray. A near return can have another azimuth, because beams start beside the
    /// centre.
    int earlier_firing(std::size_t i) const {
        const std::size_t number = return_index_of(points_, i);
        const bool follows =
            i > 0 && number > 0 && points_.firing.empty() && points_.ring[i] == points_.ring[i - 1] &&
            return_index_of(points_, i - 1) + 1 == number &&
            (points_.time_offset_s.empty() || points_.time_offset_s[i] == points_.time_offset_s[i - 1]);
        return follows ? column_of_[i - 1] : kNoPointIndex;
    }

    /// Assigns a point to its ray (ring and firing). A ray stores only one point of each
    /// return number. If no ray is free, the nearer point stays.
    void assign_point(std::size_t point_index) {
        const std::size_t ring = points_.ring[point_index], n = sweep_.firings.size(),
                          number = return_index_of(points_, point_index);
        const int earlier = earlier_firing(point_index);
        column_of_.push_back(kNoPointIndex);
        const double range = point_range_m(int(point_index));
        firing_of.push_back(kNoPointIndex);
        if (range > sensor_.max_range_m || range < kLeastRange_m) return;
        const std::size_t firing =
            earlier != kNoPointIndex ? std::size_t(earlier) : nearest_firing(point_index);
        firing_of.back() = int(firing);
        RayPointIndices& cells = indices_of_return(number);
        int point = int(point_index);
        for (const std::size_t f : {firing, (firing + 1) % n, (firing + n - 1) % n}) {
            // If the ray of a first return is occupied, tries the same ring in the two
            // neighbouring firings. A later return stays with its measured firing.
            if (cells.point_index_at(ring, f) != kNoPointIndex || (number > 0 && f != firing)) continue;
            std::swap(cells.point_index_at(ring, f), point);
            column_of_.back() = int(f);
            break;
        }
        if (point != kNoPointIndex && range < point_range_m(cells.point_index_at(ring, firing))) {
            cells.point_index_at(ring, firing) = point;
            column_of_.back() = int(firing);
        }
    }

    /// Assigns a point beyond the sensor's maximum range to its ray, if the ray has no
    /// point yet.
    void assign_far_point(std::size_t point_index) {
        if (!(double(point_range_m(int(point_index))) > sensor_.max_range_m)) return;
        const std::size_t firing = nearest_firing(point_index);
        int& point = indices_of_return(return_index_of(points_, point_index))
                         .point_index_at(points_.ring[point_index], firing);
        if (point == kNoPointIndex) point = int(point_index);
    }
};

/// Returns the mean time of the points of each firing. For a firing without points,
/// extrapolates from the nearest firing with points at the rotation rate of the head.
std::vector<double> firing_times(const LidarPoints& points, const SpinningSensor& sensor,
                                 const SweepFirings& sweep, const std::vector<int>& firing_of_point) {
    const std::size_t n = sweep.firings.size();
    const auto turning_time = [&](double azimuth_rad) {
        return (sensor.clockwise ? -azimuth_rad : azimuth_rad) / (2.0 * kPi) * sensor.period_s;
    };
    std::vector<double> time_s(n), sum(n, 0.0), count(n, 0.0);
    for (std::size_t f = 0; f < n; ++f)
        time_s[f] = turning_time(sweep.lattice.tick_azimuth_rad(sweep.firings[f]));
    for (std::size_t i = 0; i < points.time_offset_s.size(); ++i)
        if (firing_of_point[i] != kNoPointIndex) {
            sum[std::size_t(firing_of_point[i])] += double(points.time_offset_s[i]);
            count[std::size_t(firing_of_point[i])] += 1.0;
        }
    std::vector<double> measured = time_s;
    for (std::size_t f = 0; f < n; ++f) {
        // Nearest firing with points, before or after firing f.
        std::size_t from = f;
        for (std::size_t d = 1; d < n && count[from] == 0.0; ++d) {
            if (f + d < n && count[f + d] > 0.0) from = f + d;
            else if (f >= d) from = f - d;
        }
        if (count[from] == 0.0) return time_s;
        const double step = std::remainder(sweep.lattice.tick_azimuth_rad(sweep.firings[f]) -
                                               sweep.lattice.tick_azimuth_rad(sweep.firings[from]),
                                           2.0 * kPi);
        measured[f] = sum[from] / count[from] + turning_time(step);
    }
    return measured;
}

/// Resizes all arrays of a scan. Every ray starts at the sensor origin without a
/// return.
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

/// Sets the direction and the range of a ray with a return. The direction is from the
/// beam's origin to the point. Returns false and sets nothing if the point is too close
/// to the origin.
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
    if (sensor.columns < 1 || sensor.beams.size() * std::size_t(sensor.columns) > kMaxRays ||
        firings.lattice.n_ticks > kMostTicks)
        fail<UsageError>(
            "cannot make a scan: found {} beams, {} columns and {} azimuth steps, expected 1 to {} rays and "
            "at most {} steps",
            sensor.beams.size(), sensor.columns, firings.lattice.n_ticks, kMaxRays, kMostTicks);
    if (firings.firings.empty())
        fail<UsageError>("cannot make a scan of {} points: found no firing, expected at least one",
                         points.size());
    for (const std::uint32_t firing : points.firing)
        if (firing >= firings.firings.size())
            fail<UsageError>(
                "cannot make a scan: a point has firing {}, expected the index of one of {} firings", firing,
                firings.firings.size());
    const std::vector<BeamRays> beams = make_generators(sensor.beams);
    std::vector<double> head_rad(points.size());
    for (std::size_t i = 0; i < points.size(); ++i)
        head_rad[i] = beams[points.ring[i]].azimuth_facing(glm::dvec3(points.position_m[i]));
    PointToRayAssignment assigned(points, sensor, firings, head_rad);
    const std::vector<double> times = firing_times(points, sensor, firings, assigned.firing_of);
    const std::vector<int> slot = firing_per_column(firings, sensor.columns);
    std::vector<double> firing_rad;
    for (const int tick : firings.firings) firing_rad.push_back(firings.lattice.tick_azimuth_rad(tick));
    const int columns = sensor.columns;
    Scan scan;
    resize_scan(scan, int(sensor.beams.size()), columns, assigned.by_return.size() - 1,
                !points.classes.empty());
    scan.rays.divergence_rad = float(sensor.divergence_rad);
    std::size_t at = 0;
    for (std::size_t ring = 0; ring < sensor.beams.size(); ++ring) {
        // Firing f of a beam with an azimuth offset is stored in column f - `shift`.
        const int shift = offset_columns(sensor.beams[ring], columns);
        for (int column = 0; column < columns; ++column, ++at) {
            const std::size_t firing =
                std::size_t(slot[std::size_t(((column + shift) % columns + columns) % columns)]);
            scan.rays.time_offset_s[at] = float(times[firing]);
            scan.rays.channel[at] = std::uint16_t(ring);
            const int first = assigned.by_return[0].point_index_at(ring, firing);
            if (first == kNoPointIndex ||
                !set_ray(scan, at, beams[ring], head_rad[std::size_t(first)], points, std::size_t(first))) {
                // A dropped ray is that of the ideal beam, and its range stays 0.
                const BeamRay model = beams[ring].compute_ray(firing_rad[firing]);
                scan.rays.origin[at] = glm::vec3(model.origin_m);
                scan.rays.direction[at] = glm::vec3(model.direction);
            }
            for (std::size_t number = 1; number < assigned.by_return.size(); ++number)
                if (const int i = assigned.by_return[number].point_index_at(ring, firing); i != kNoPointIndex)
                    set_second(scan, at, points, std::size_t(i));
        }
    }
    return scan;
}

Scan scan_of_points(const LidarPoints& points) {
    check_points(points, 0);
    std::vector<std::size_t> first;  // [rays] index of the point that is the first return of each ray
    std::size_t n_second_returns = 0;
    if (points.size() > kMaxRays)
        fail<UsageError>("cannot make a scan: found {} points, expected at most {}", points.size(), kMaxRays);
    for (std::size_t i = 0; i < points.size(); ++i) {
        n_second_returns = std::max(n_second_returns, return_index_of(points, i));
        if (return_index_of(points, i) == 0 && glm::length(points.position_m[i]) > float(kLeastRange_m))
            first.push_back(i);
    }
    Scan scan;
    resize_scan(scan, 1, int(first.size()), n_second_returns, !points.classes.empty());
    for (std::size_t at = 0; at < first.size(); ++at) {
        const std::size_t i = first[at];
        const float range = glm::length(points.position_m[i]);
        scan.rays.direction[at] = glm::vec3(glm::normalize(glm::dvec3(points.position_m[i])));
        // Missing times and rings become 0.
        scan.rays.time_offset_s[at] = points.time_offset_s.empty() ? 0.0f : points.time_offset_s[i];
        scan.rays.channel[at] = points.ring.empty() ? std::uint16_t(0) : points.ring[i];
        scan.range_m[at] = range;
        scan.intensity[at] = glm::clamp(points.intensity[i], 0.0f, 1.0f);
        if (!points.classes.empty()) scan.classes[at] = points.classes[i];
        // Further returns of the ray directly follow its first return.
        for (std::size_t k = i + 1; k < points.size() && return_index_of(points, k) > 0; ++k)
            set_second(scan, at, points, k);
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
