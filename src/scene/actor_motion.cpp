// SPDX-License-Identifier: Apache-2.0
// Computes the pose and the motion of an actor at the time when a LiDAR head faces it.
#include <relidar/scene/device_scene.hpp>

#include <cmath>

namespace relidar {
namespace {

constexpr double kMaxBeamOffset_rad = 0.17;  // maximum azimuth between a beam and the rotating head
// The azimuths that a box covers are widened on each side by this share of their half
// width, because the sensor and the box move during the scan.
constexpr double kWideningShare = 0.25;
// The time span of a motion is lengthened by this share, because real LiDAR heads deviate
// from the nominal firing times.
constexpr double kLengtheningShare = 0.02;
constexpr double kUnknownSweep_s = 0.1;  // assumed half duration of a sweep, if unknown
constexpr double kVelocityStep_s = 0.005;

struct TimeSpan {
    double first_s, last_s;
};

/// Returns the time interval in which a LiDAR fires the rays of a sweep.
TimeSpan sweep_span(const Log& log, const SweepTiming& sweep) {
    const Lidar& lidar = log.lidars[std::size_t(sweep.lidar)];
    if (!log.rolling_shutter) return {sweep.time_s, sweep.time_s};
    // A spinning sensor needs one period for a sweep.
    const double period_s = lidar.sweep_period_s();
    if (period_s > 0.0) {
        const double first_s = sweep.time_s + (sweep.start ? sweep.start->time_s : -0.5 * period_s);
        return {first_s, first_s + period_s};
    }
    // Other sensors list the firing times in their pattern.
    const RayTable* table = lidar.pattern ? std::get_if<RayTable>(&*lidar.pattern) : nullptr;
    if (!table || table->time_offset_s.empty())
        return {sweep.time_s - kUnknownSweep_s, sweep.time_s + kUnknownSweep_s};
    const auto [first, last] = std::ranges::minmax_element(table->time_offset_s);
    return {sweep.time_s + double(*first), sweep.time_s + double(*last)};
}

/// Returns how many seconds the LiDAR needs to turn by one radian. Returns 0 if it does
/// not scan the azimuths in order.
double seconds_per_rad(const Lidar& lidar) {
    if (!lidar.pattern) return lidar.sensor.period_s / (2.0 * kPi);
    const ScanPatternSummary summary = summarise_pattern(*lidar.pattern);
    const std::optional<AzimuthSweep>& sweep = summary.sweep;
    return sweep && sweep->columns > 1 ? summary.period_s / std::abs(sweep->last_rad - sweep->first_rad)
                                       : 0.0;
}

/// Returns half the azimuth angle that a box covers in the view of the sensor. Returns pi
/// if the sensor is inside or above the box.
double half_width_rad(const Pose& sensor_from_box, const glm::dvec3& half_size_m) {
    const glm::dvec3& centre = sensor_from_box.translation;
    if (std::hypot(centre.x, centre.y) <= glm::length(half_size_m)) return kPi;
    const double azimuth_rad = std::atan2(centre.y, centre.x);
    double largest_rad = 0.0;
    for (int corner = 0; corner < 8; ++corner) {
        // The three bits of `corner` are the signs of its coordinates.
        const glm::dvec3 sign(corner & 1 ? 1.0 : -1.0, corner & 2 ? 1.0 : -1.0, corner & 4 ? 1.0 : -1.0);
        const glm::dvec3 corner_m = sensor_from_box * (sign * half_size_m);
        const double off_centre_rad =
            std::remainder(std::atan2(corner_m.y, corner_m.x) - azimuth_rad, 2.0 * kPi);
        largest_rad = std::max(largest_rad, std::abs(off_centre_rad));
    }
    return largest_rad;
}

/// Returns the time interval in which the rotating head faces a box: the time at which it
/// faces the centre, plus and minus the time in which it sweeps over half of the box.
/// Returns the time of the full sweep if the interval is unknown or extends beyond it.
TimeSpan facing_span(const Log& log, const PoseTrack& world_from_box, const glm::dvec3& half_size_m,
                     const SweepTiming& sweep) {
    const TimeSpan all = sweep_span(log, sweep);
    const Lidar& lidar = log.lidars[std::size_t(sweep.lidar)];
    const double s_per_rad = seconds_per_rad(lidar);
    const bool is_unknown = s_per_rad <= 0.0 || half_size_m == glm::dvec3(0.0);
    if (is_unknown || all.last_s <= all.first_s) return all;
    const auto sensor_from_box = [&](double t_s) {
        return inverse(log.world_from_vehicle.mounted_pose_at(t_s, lidar.vehicle_from_sensor)) *
               world_from_box.pose_at(t_s);
    };
    // The time depends on the pose of the box at this time. Three iterations converge.
    double faced_s = sweep.time_s;
    for (int step = 0; step < 3; ++step)
        faced_s = facing_time_s(log, sensor_from_box(faced_s).translation, sweep);
    const double half_rad = half_width_rad(sensor_from_box(faced_s), half_size_m);
    const double half_s = ((1.0 + kWideningShare) * half_rad + kMaxBeamOffset_rad) * s_per_rad;
    const TimeSpan span{faced_s - half_s, faced_s + half_s};
    const bool is_in_sweep = span.first_s >= all.first_s && span.last_s <= all.last_s;
    return half_rad < kPi && is_in_sweep ? span : all;
}

}  // namespace

InstancePose box_pose_in_sweep(const Log& log, const PoseTrack& world_from_box, const glm::dvec3& half_size_m,
                               const SweepTiming& sweep) {
    const TimeSpan hit = facing_span(log, world_from_box, half_size_m, sweep);
    const double half_s = 0.5 * (hit.last_s - hit.first_s), middle_s = 0.5 * (hit.first_s + hit.last_s);
    // The velocity is measured over the time in which rays can hit the box. If all rays
    // fire at once, it is measured between kVelocityStep_s before and after this time.
    const bool moves = half_s > 0.0;
    const double half_measured_s = moves ? half_s : kVelocityStep_s;
    const TimeSpan measured = moves ? hit : TimeSpan{middle_s - kVelocityStep_s, middle_s + kVelocityStep_s};
    const Pose first = world_from_box.pose_at(measured.first_s),
               last = world_from_box.pose_at(measured.last_s);
    const Twist twist = compute_twist(first, last);  // translation, then rotation vector
    const double per_s = 0.5 / half_measured_s;
    const PoseMotion motion{.velocity_mps = per_s * glm::dvec3(twist[0], twist[1], twist[2]),
                            .angular_velocity_radps = per_s * glm::dvec3(twist[3], twist[4], twist[5]),
                            .middle_s = middle_s - sweep.time_s,
                            .half_span_s = (1.0 + kLengtheningShare) * half_s};
    const Pose middle = moves ? interpolate(first, last, 0.5) : world_from_box.pose_at(middle_s);
    return {.world_from_model = middle, .present = true, .time_s = middle_s, .phase = 0.0, .motion = motion};
}

}  // namespace relidar
