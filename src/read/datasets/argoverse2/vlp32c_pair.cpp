// SPDX-License-Identifier: Apache-2.0
// Geometry and timing of the VLP-32C. The sensor fires its 32 lasers in pairs while the
// head rotates: one pair every 2.304 us, all lasers every 55.296 us. The azimuth of a
// laser relative to the head at the first pair is therefore a sum: the azimuth offset of
// the laser plus the rotation since the first pair.
#include "read/datasets/argoverse2/vlp32c_pair.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <variant>

#include <relidar/log/sensor_pattern.hpp>

#include "read/scans/sweep_firings.hpp"

namespace relidar::argoverse2 {
namespace {

constexpr double kFiringCycle_ns = 55296.0, kRate_hz = 10.0;
constexpr const char* kVlp32cName = "VLP-32C";

/// [VLP-32C channels] Laser number of each channel in Argoverse 2 files, modulo 32. The
/// files number the lasers of two LiDARs 0 to 63. Derived from a published sweep.
constexpr std::array<int, kLasersPerLidar> kLaserNumbers = {31, 13, 1,  17, 29, 9,  3,  21, 27, 12, 5,
                                                            16, 25, 8,  7,  20, 22, 2,  10, 28, 23, 6,
                                                            11, 24, 18, 0,  14, 30, 19, 4,  15, 26};

std::vector<Beam> nominal_beams() {
    return std::get<SpinningSensor>(find_built_in(kVlp32cName, 1, kRate_hz)->pattern).beams;
}

struct LaserRowTiming {
    std::uint16_t row = 0;
    double after_first_ns = 0.0;
    double elevation_rad = 0.0;
};
std::array<LaserRowTiming, kLasersPerLidar> make_laser_rows() {
    std::array<LaserRowTiming, kLasersPerLidar> laser_table;
    const std::vector<BeamFiring> firings = read_firings(kVlp32cName);
    const std::vector<Beam> beams = nominal_beams();
    for (std::size_t row = 0; row < firings.size(); ++row)
        laser_table[std::size_t(kLaserNumbers[std::size_t(firings[row].channel)])] = {
            std::uint16_t(row), 1e3 * firings[row].offset_us, beams[row].elevation_rad};
    return laser_table;
}

/// Returns the mean absolute difference between the elevation of a point and of its
/// laser. Each difference is at most one degree, so that outliers have little influence.
double elevation_error_rad(const RawSweep& sweep, int laser_group, const Pose& vehicle_from_lidar) {
    const std::array<LaserRowTiming, kLasersPerLidar> laser_table = make_laser_rows();
    const Pose lidar_from_vehicle = inverse(vehicle_from_lidar);
    constexpr double kLargestDifference_rad = kPi / 180.0;
    double sum = 0.0, n = 0.0;
    for (std::size_t i = 0; i < sweep.point_m.size(); ++i) {
        if (sweep.laser[i] / kLasersPerLidar != laser_group) continue;
        const glm::dvec3 p = lidar_from_vehicle * sweep.point_m[i];
        const double elevation = std::atan2(p.z, std::hypot(p.x, p.y));
        sum += std::min(
            std::abs(elevation - laser_table[std::size_t(sweep.laser[i] % kLasersPerLidar)].elevation_rad),
            kLargestDifference_rad);
        n += 1.0;
    }
    return n > 0.0 ? sum / n : 0.0;
}

/// Returns the index of the firing cycle of each point. All lasers fire once per cycle.
/// Cycle 0 starts near the time stamp of the sweep. Its exact start is the circular mean
/// of all points.
std::vector<int> number_cycles(const std::vector<double>& cycle_start_of_each_point_ns) {
    std::complex<double> sum = 0.0;
    for (const double t : cycle_start_of_each_point_ns)
        sum += std::polar(1.0, 2.0 * kPi * t / kFiringCycle_ns);
    const double phase_ns = std::arg(sum) / (2.0 * kPi) * kFiringCycle_ns;
    std::vector<int> numbers;
    for (const double t : cycle_start_of_each_point_ns)
        numbers.push_back(int(std::lround((t - phase_ns) / kFiringCycle_ns)));
    return numbers;
}

}  // namespace

SpinningSensor make_vlp32c(bool clockwise) {
    SpinningSensor sensor;
    sensor.name = "VLP-32C";
    sensor.clockwise = clockwise;
    sensor.period_s = 1.0 / kRate_hz;
    sensor.beams = nominal_beams();  // of a head that rotates clockwise
    const std::vector<BeamFiring> firings = read_firings(kVlp32cName);
    for (std::size_t row = 0; row < firings.size() && !clockwise; ++row)
        // The offsets contain the clockwise rotation since the first pair. Adding it
        // twice reverses its sign.
        sensor.beams[row].azimuth_offset_rad += 2.0 * 2.0 * kPi * kRate_hz * 1e-6 * firings[row].offset_us;
    return sensor;
}

std::array<int, 2> match_laser_groups(const RawSweep& sweep, const std::array<Pose, 2>& vehicle_from_lidar) {
    const double straight = elevation_error_rad(sweep, 0, vehicle_from_lidar[0]) +
                            elevation_error_rad(sweep, 1, vehicle_from_lidar[1]);
    const double crossed = elevation_error_rad(sweep, 1, vehicle_from_lidar[0]) +
                           elevation_error_rad(sweep, 0, vehicle_from_lidar[1]);
    return straight <= crossed ? std::array{0, 1} : std::array{1, 0};
}

SweepPoints extract_group(const RawSweep& raw_sweep, int laser_group, const Lidar& lidar,
                          const PoseTrack& world_from_sensor, double sweep_time_s) {
    const std::array<LaserRowTiming, kLasersPerLidar> laser_table = make_laser_rows();
    const Pose lidar_from_vehicle = inverse(lidar.vehicle_from_sensor);
    SweepPoints result;
    std::vector<double> first_pair_ns;
    for (std::size_t i = 0; i < raw_sweep.point_m.size(); ++i) {
        if (raw_sweep.laser[i] / kLasersPerLidar != laser_group) continue;
        const LaserRowTiming& laser = laser_table[std::size_t(raw_sweep.laser[i] % kLasersPerLidar)];
        result.points.position_m.emplace_back(lidar_from_vehicle * raw_sweep.point_m[i]);
        result.points.intensity.push_back(float(raw_sweep.intensity[i] / 255.0));
        result.points.ring.push_back(laser.row);
        result.points.time_offset_s.push_back(float(double(raw_sweep.offset_ns[i]) * 1e-9));
        // Time of the first pair of lasers in the cycle of this point.
        first_pair_ns.push_back(double(raw_sweep.offset_ns[i]) - laser.after_first_ns);
    }
    if (result.points.size() == 0) return result;
    undo_deskew(result.points, world_from_sensor, sweep_time_s);
    // Azimuth step of the head from firing cycle to firing cycle.
    const double step_rad = (lidar.sensor.clockwise ? -2.0 : 2.0) * kPi * kRate_hz * kFiringCycle_ns * 1e-9;
    result.sweep = arrange_firings(result.points, number_cycles(first_pair_ns), lidar.sensor, step_rad);
    return result;
}

}  // namespace relidar::argoverse2
