// SPDX-License-Identifier: Apache-2.0
#include "read/files/file_order.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <optional>

#include <relidar/base/math.hpp>

#include "base/median.hpp"

namespace relidar::read {
namespace {

// Within a ring, the azimuth can jump back by at most this angle. Motion compensation
// moves near points by over 20 degrees where a sweep begins and ends (KITTI odometry).
constexpr double kRingStepBack_rad = kPi / 2.0;
// Share of steps with the same sign: of azimuths in files in the order of rotation, and
// of elevations from ring to ring, if rings are sorted. In KITTI, at least 0.98 have.
constexpr double kMinSameSignShare = 0.9;
// The search for the start of rings uses only every fourth point, to save time.
constexpr std::size_t kSearchStride = 4;
// Points in another order can give any number of rings, but no LiDAR has more than 256.
constexpr std::size_t kFewestRings = 4, kMostOrderedRings = 256;
// Points are in the correct rings if the median elevation difference between a point and
// its ring is below this share of the difference between the first and the last ring. In
// motion-compensated scans of KITTI, it is 0.02 at 27 m/s.
constexpr double kMaxRingErrorShare = 0.1;

double azimuth_of_rad(const glm::vec3& point) { return std::atan2(double(point.y), double(point.x)); }
double elevation_of_rad(const glm::vec3& point) {
    return std::atan2(double(point.z), std::hypot(double(point.x), double(point.y)));
}

/// Returns 1 if the azimuth increases from point to point, -1 if it decreases, and
/// nothing if the points are not in the order of rotation.
std::optional<double> rotation_sign_of(const LidarPoints& points) {
    std::size_t n_up = 0, n_down = 0;
    for (std::size_t i = 1; i < points.size(); ++i) {
        const double step_rad = std::remainder(
            azimuth_of_rad(points.position_m[i]) - azimuth_of_rad(points.position_m[i - 1]), 2.0 * kPi);
        if (step_rad > 0.0) ++n_up;
        if (step_rad < 0.0) ++n_down;
    }
    const double least = kMinSameSignShare * double(points.size());
    if (double(n_up) > least) return 1.0;
    if (double(n_down) > least) return -1.0;
    return std::nullopt;
}

/// Returns the azimuth of each point without jumps at full turns. The result increases.
/// @param rotation_sign  1 if azimuths increase in the file, -1 if they decrease
std::vector<double> unwrap_azimuths(const LidarPoints& points, double rotation_sign) {
    std::vector<double> unwrapped_rad;
    unwrapped_rad.reserve(points.size());
    for (const glm::vec3& point : points.position_m) {
        const double azimuth_rad = rotation_sign * azimuth_of_rad(point);
        if (unwrapped_rad.empty()) {
            unwrapped_rad.push_back(azimuth_rad);
            continue;
        }
        double step_rad = std::remainder(azimuth_rad - unwrapped_rad.back(), 2.0 * kPi);
        // Small steps back are noise. After a larger one, the file continues with a turn.
        if (step_rad < -kRingStepBack_rad) step_rad += 2.0 * kPi;
        unwrapped_rad.push_back(unwrapped_rad.back() + step_rad);
    }
    return unwrapped_rad;
}

/// Returns the revolution number of each point, from 0: how often the azimuth has passed
/// `start_azimuth_rad` before this point. In files that store one ring after another,
/// this is the number of the ring.
/// @param azimuths_rad  without jumps at full turns, see unwrap_azimuths(); not empty
std::vector<std::uint16_t> count_turns(const std::vector<double>& azimuths_rad, double start_azimuth_rad) {
    std::vector<std::uint16_t> revolution_numbers;
    revolution_numbers.reserve(azimuths_rad.size());
    const auto revolution_of = [&](double azimuth_rad) {
        return std::floor((azimuth_rad - start_azimuth_rad) / (2.0 * kPi));
    };
    const double first_revolution = revolution_of(std::ranges::min(azimuths_rad));
    int last = 0;
    for (const double azimuth_rad : azimuths_rad) {
        // Ring numbers never decrease. Otherwise rounding errors could put the first
        // point of a ring into the previous ring.
        last = std::max(last, int(revolution_of(azimuth_rad) - first_revolution));
        revolution_numbers.push_back(std::uint16_t(std::min(last, int(kMostOrderedRings))));
    }
    return revolution_numbers;
}

/// Returns the median elevation of each ring in radians, or NaN for an empty ring. Uses
/// only the farther half of the points: beams start beside the sensor origin, so
/// elevations of near points, seen from the origin, are wrong.
std::vector<double> ring_elevations(const LidarPoints& points, const std::vector<std::uint16_t>& rings) {
    std::vector<std::vector<std::pair<float, double>>> samples_by_ring;  // range (sort key), elevation
    for (std::size_t i = 0; i < points.size(); ++i) {
        if (rings[i] >= samples_by_ring.size()) samples_by_ring.resize(std::size_t(rings[i]) + 1);
        samples_by_ring[rings[i]].emplace_back(glm::length(points.position_m[i]),
                                               elevation_of_rad(points.position_m[i]));
    }
    std::vector<double> elevations;
    for (auto& points_of_ring : samples_by_ring) {
        if (points_of_ring.empty()) {
            elevations.push_back(NAN);
            continue;
        }
        const auto half = points_of_ring.begin() + std::ptrdiff_t(points_of_ring.size() / 2);
        std::nth_element(points_of_ring.begin(), half, points_of_ring.end());
        std::vector<double> far;
        for (auto p = half; p != points_of_ring.end(); ++p) far.push_back(p->second);
        elevations.push_back(compute_median(far));
    }
    return elevations;
}

/// Returns the absolute difference between the elevations of each point and of its ring.
std::vector<double> ring_errors(const LidarPoints& points, const std::vector<std::uint16_t>& ring_of_point,
                                const std::vector<double>& ring_elevations_rad) {
    std::vector<double> errors;
    errors.reserve(points.size());
    for (std::size_t i = 0; i < points.size(); ++i)
        errors.push_back(
            std::abs(elevation_of_rad(points.position_m[i]) - ring_elevations_rad[ring_of_point[i]]));
    return errors;
}

/// Returns the azimuth at which the rings of a file begin. At a wrong azimuth, rings
/// contain points of two beams, so points deviate more from the elevation of their ring.
double find_ring_start_rad(const LidarPoints& points, const std::vector<double>& unwrapped_azimuths_rad) {
    LidarPoints sample;
    std::vector<double> sample_azimuths_rad;
    for (std::size_t i = 0; i < points.size(); i += kSearchStride) {
        sample.position_m.push_back(points.position_m[i]);
        sample_azimuths_rad.push_back(unwrapped_azimuths_rad[i]);
    }
    const auto mean_error = [&](double start_rad) {
        const std::vector<std::uint16_t> ring = count_turns(sample_azimuths_rad, start_rad);
        const std::vector<double> errors = ring_errors(sample, ring, ring_elevations(sample, ring));
        // Unlike the median, the mean increases with even a few points in a wrong ring.
        return std::accumulate(errors.begin(), errors.end(), 0.0) / double(errors.size());
    };
    double least_error = INFINITY, best_rad = 0.0;
    const auto search_around = [&](double middle_rad, int step_deg, int n_steps) {
        for (int k = -n_steps; k <= n_steps; ++k) {
            const double candidate_rad = middle_rad + k * step_deg * kPi / 180.0;
            const double error = mean_error(candidate_rad);
            if (error < least_error) {
                least_error = error;
                best_rad = candidate_rad;
            }
        }
    };
    search_around(0.0, 10, 18);     // the full turn in steps of 10 degrees
    search_around(best_rad, 1, 9);  // then steps of 1 degree
    return best_rad;
}

/// Returns true if the rings are sorted by elevation and clearly separated. In separated
/// rings, most points are closer to the elevation of their ring than to other rings.
bool are_rings_clear(const LidarPoints& points, const std::vector<std::uint16_t>& ring_of_point,
                     const std::vector<double>& ring_elevations_rad) {
    if (ring_elevations_rad.size() < kFewestRings || ring_elevations_rad.size() > kMostOrderedRings)
        return false;
    std::size_t n_up = 0, n_down = 0;
    for (std::size_t r = 1; r < ring_elevations_rad.size(); ++r) {
        const double step_rad = ring_elevations_rad[r] - ring_elevations_rad[r - 1];
        if (step_rad > 0.0) ++n_up;
        if (step_rad < 0.0) ++n_down;
    }
    const bool are_sorted =
        double(std::max(n_up, n_down)) >= kMinSameSignShare * double(ring_elevations_rad.size() - 1);
    return are_sorted &&
           compute_median(ring_errors(points, ring_of_point, ring_elevations_rad)) <
               kMaxRingErrorShare * std::abs(ring_elevations_rad.back() - ring_elevations_rad.front());
}

}  // namespace

RingOrderDetector::RingOrderDetector(const std::vector<LidarPoints>& scans) {
    // In a file of rings, the azimuth makes one turn per ring. The scan with the most
    // points shows the direction of rotation, and the azimuth at which rings begin.
    const auto fullest = std::ranges::max_element(scans, {}, &LidarPoints::size);
    if (fullest == scans.end()) return;
    const std::optional<double> rotation_sign = rotation_sign_of(*fullest);
    if (!rotation_sign) return;
    rotation_sign_ = *rotation_sign;
    const std::vector<double> azimuths_rad = unwrap_azimuths(*fullest, rotation_sign_);
    const double n_turns = (azimuths_rad.back() - azimuths_rad.front()) / (2.0 * kPi);
    if (n_turns < double(kFewestRings - 1)) return;  // the last ring can be incomplete
    first_azimuth_rad_ = find_ring_start_rad(*fullest, azimuths_rad);
    std::vector<std::vector<double>> elevations_of_scan;
    for (const LidarPoints& scan : scans) {
        if (rotation_sign_of(scan) != rotation_sign) continue;
        const std::vector<std::uint16_t> ring =
            count_turns(unwrap_azimuths(scan, rotation_sign_), first_azimuth_rad_);
        std::vector<double> elevations = ring_elevations(scan, ring);
        if (are_rings_clear(scan, ring, elevations)) elevations_of_scan.push_back(std::move(elevations));
    }
    if (elevations_of_scan.empty()) return;
    // A scan with many rings has returns of every beam. But a stray point can look like
    // another ring, as in one of 100 scans of KITTI, so two scans must have as many
    // rings.
    std::ranges::sort(elevations_of_scan, std::greater(), &std::vector<double>::size);
    const auto same = std::ranges::adjacent_find(elevations_of_scan, {}, &std::vector<double>::size);
    elevation_rad_ = same == elevations_of_scan.end() ? elevations_of_scan.front() : *same;
}

void RingOrderDetector::number_rings(LidarPoints& points) const {
    points.ring.clear();
    if (points.size() == 0) return;
    // A ring begins when the azimuth passes the start that the constructor found.
    points.ring = count_turns(unwrap_azimuths(points, rotation_sign_), first_azimuth_rad_);
    const std::vector<double> elevations = ring_elevations(points, points.ring);
    if (elevations.size() == n_rings()) return;
    // Rings are missing in this scan, so their elevations decide which rings they are.
    std::vector<std::uint16_t> nearest;
    for (const double elevation : elevations) {
        const auto difference = [&](double other) { return std::abs(other - elevation); };
        const auto ring = std::ranges::min_element(elevation_rad_, {}, difference);
        nearest.push_back(std::uint16_t(ring - elevation_rad_.begin()));
    }
    for (std::uint16_t& ring : points.ring) ring = nearest[ring];
}

}  // namespace relidar::read
