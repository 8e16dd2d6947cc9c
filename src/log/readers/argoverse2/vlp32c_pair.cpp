// SPDX-License-Identifier: Apache-2.0
// Geometry and timing of the VLP-32C. The sensor fires its 32 lasers in pairs while the
// head rotates: one pair every 2.304 us, all lasers every 55.296 us. The azimuth of a
// laser is measured from the azimuth of the head at the first pair. So it is the azimuth
// offset of the laser plus the rotation since the first pair.
#include "log/readers/argoverse2/vlp32c_pair.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <numeric>

#include "log/clouds/arrange_firings.hpp"

namespace relidar::argoverse2 {
namespace {

constexpr double kCycle_ns = 55296.0, kPair_ns = 2304.0, kRate_hz = 10.0;

struct Laser {
    int number;  ///< Argoverse's laser_number, modulo 32
    double elevation_deg, azimuth_deg;
};
// Lasers in the order of firing, two lasers per firing. The nominal angles are from
// VeloView-VLP-32C.yaml of ros-drivers/velodyne (BSD). The laser numbers of Argoverse and
// the firing order were derived from the times and elevations of points in a published
// sweep.
constexpr Laser kTable[kLasers] = {
    {31, -25.000, -1.4}, {13, -1.000, 4.2},  {1, -1.667, -1.4},  {17, -15.639, 1.4}, {29, -11.310, -1.4},
    {9, 0.000, 1.4},     {3, -0.667, -4.2},  {21, -8.843, 1.4},  {27, -7.254, -1.4}, {12, 0.333, 4.2},
    {5, -0.333, -1.4},   {16, -6.148, 1.4},  {25, -5.333, -4.2}, {8, 1.333, 1.4},    {7, 0.667, -4.2},
    {20, -4.000, 1.4},   {22, -4.667, -1.4}, {2, 1.667, 4.2},    {10, 1.000, -1.4},  {28, -3.667, 4.2},
    {23, -3.333, -4.2},  {6, 3.333, 1.4},    {11, 2.333, -1.4},  {24, -2.667, 1.4},  {18, -3.000, -1.4},
    {0, 7.000, 1.4},     {14, 4.667, -1.4},  {30, -2.333, 4.2},  {19, -2.000, -4.2}, {4, 15.000, 1.4},
    {15, 10.333, -1.4},  {26, -1.333, 1.4},
};

double to_radians(double degrees) { return degrees * kPi / 180.0; }

/// Returns the indices of the table rows, sorted by elevation with the highest laser
/// first.
std::array<int, kLasers> make_row_order() {
    std::array<int, kLasers> entries;
    std::iota(entries.begin(), entries.end(), 0);
    std::sort(entries.begin(), entries.end(), [](int first, int second) {
        return kTable[first].elevation_deg > kTable[second].elevation_deg;
    });
    return entries;
}

/// Row of a laser in the range image, delay of the laser after the first firing, and
/// elevation of the laser.
struct LaserPlace {
    std::uint16_t row = 0;
    double after_first_ns = 0.0;
    double elevation_rad = 0.0;
};
std::array<LaserPlace, kLasers> make_laser_table() {
    std::array<LaserPlace, kLasers> places;
    const std::array<int, kLasers> entries = make_row_order();
    for (int row = 0; row < kLasers; ++row) {
        const int entry = entries[std::size_t(row)];
        const Laser& laser = kTable[entry];
        places[std::size_t(laser.number)] = {std::uint16_t(row), entry / 2 * kPair_ns,
                                             to_radians(laser.elevation_deg)};
    }
    return places;
}

/// Returns the mean absolute difference between the elevations of points and the nominal
/// elevations of their lasers. Limits each difference to one degree, so that outliers
/// have little influence.
double compute_misfit(const RawSweep& sweep, int half, const Pose& vehicle_from_lidar) {
    const std::array<LaserPlace, kLasers> places = make_laser_table();
    const Pose lidar_from_vehicle = inverse(vehicle_from_lidar);
    double sum = 0.0, n = 0.0;
    for (std::size_t i = 0; i < sweep.point_m.size(); ++i) {
        if (sweep.laser[i] / kLasers != half) continue;
        const glm::dvec3 p = lidar_from_vehicle * sweep.point_m[i];
        const double elevation = std::atan2(p.z, std::hypot(p.x, p.y));
        sum += std::min(std::abs(elevation - places[std::size_t(sweep.laser[i] % kLasers)].elevation_rad),
                        to_radians(1.0));
        n += 1.0;
    }
    return n > 0.0 ? sum / n : 0.0;
}

/// Returns for each point the number of the firing cycle that measured the point. Cycle 0
/// is near the time stamp of the sweep. The clock of the packets is different, so the
/// function estimates the phase of the cycles from all points.
std::vector<int> compute_firing_numbers(const std::vector<double>& first_pair_ns) {
    std::complex<double> sum = 0.0;
    for (const double t : first_pair_ns) sum += std::polar(1.0, 2.0 * kPi * t / kCycle_ns);
    const double phase_ns = std::arg(sum) / (2.0 * kPi) * kCycle_ns;
    std::vector<int> numbers;
    for (const double t : first_pair_ns) numbers.push_back(int(std::lround((t - phase_ns) / kCycle_ns)));
    return numbers;
}

}  // namespace

SpinningSensor make_vlp32c(bool clockwise) {
    SpinningSensor sensor;
    sensor.name = "VLP-32C";
    sensor.clockwise = clockwise;
    sensor.period_s = 1.0 / kRate_hz;
    for (const int entry : make_row_order()) {
        const Laser& laser = kTable[entry];
        const double turned = 2.0 * kPi * kRate_hz * 1e-9 * (entry / 2) * kPair_ns;
        sensor.beams.push_back(
            {.elevation_rad = to_radians(laser.elevation_deg),
             .azimuth_offset_rad = to_radians(laser.azimuth_deg) + (clockwise ? -turned : turned)});
    }
    return sensor;
}

std::array<int, 2> find_halves(const RawSweep& sweep, const std::array<Pose, 2>& vehicle_from_lidar) {
    const double straight =
        compute_misfit(sweep, 0, vehicle_from_lidar[0]) + compute_misfit(sweep, 1, vehicle_from_lidar[1]);
    const double crossed =
        compute_misfit(sweep, 1, vehicle_from_lidar[0]) + compute_misfit(sweep, 0, vehicle_from_lidar[1]);
    return straight <= crossed ? std::array{0, 1} : std::array{1, 0};
}

LidarSweep make_lidar_sweep(const RawSweep& raw, int half, const Lidar& lidar,
                            const PoseTrack& world_from_sensor, double time_s) {
    const std::array<LaserPlace, kLasers> places = make_laser_table();
    const Pose lidar_from_vehicle = inverse(lidar.vehicle_from_sensor);
    LidarSweep result;
    std::vector<double> first_pair_ns;
    for (std::size_t i = 0; i < raw.point_m.size(); ++i) {
        if (raw.laser[i] / kLasers != half) continue;
        const LaserPlace& laser = places[std::size_t(raw.laser[i] % kLasers)];
        result.points.position_m.emplace_back(lidar_from_vehicle * raw.point_m[i]);
        result.points.intensity.push_back(float(raw.intensity[i] / 255.0));
        result.points.ring.push_back(laser.row);
        result.points.time_offset_s.push_back(float(double(raw.offset_ns[i]) * 1e-9));
        first_pair_ns.push_back(double(raw.offset_ns[i]) - laser.after_first_ns);
    }
    if (result.points.size() == 0) return result;
    undo_compensation(result.points, world_from_sensor, time_s);
    const double step_rad = (lidar.sensor.clockwise ? -2.0 : 2.0) * kPi * kRate_hz * kCycle_ns * 1e-9;
    result.sweep =
        arrange_firings(result.points, compute_firing_numbers(first_pair_ns), lidar.sensor, step_rad);
    return result;
}

}  // namespace relidar::argoverse2
