// SPDX-License-Identifier: Apache-2.0
// Estimates the beams and columns of a spinning LiDAR from its points. The elevation of a
// ring is the median over its points. The number of columns and the azimuth offsets of
// the rings are computed from the azimuths. Also checks whether points come from a
// spinning LiDAR. Other LiDARs scan a window or a rosette pattern.
#include <relidar/read/clouds.hpp>

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <functional>
#include <numeric>
#include <span>

#include <Eigen/Dense>

#include "base/fail.hpp"
#include "base/geometry/circular_gap.hpp"
#include "base/median.hpp"
#include "read/scans/scan_plan.hpp"

namespace relidar {
namespace {

constexpr double kLeastStep_rad = 2e-4;   // minimum azimuth step between two firings (about 0.01 degrees)
constexpr double kLargestStep_rad = 0.2;  // Larger steps are gaps without returns.
// The first estimate of the number of columns may be wrong by this share.
constexpr double kColumnSearchMargin = 0.03;
// Minimum coherence: 1 if the points of each ring are on a regular azimuth grid.
constexpr double kMinCoherence = 0.5;
// Maximum factor by which the points of a ring raise the estimated number of columns.
constexpr double kMostColumns = 1.1;
constexpr std::size_t kFewestSteps = 16;
constexpr std::size_t kMostRings = 4096;
// Maximum difference between the 90th and the 10th percentile of the elevations of a
// ring, for the farther half of its points. KITTI has 0.1 degrees, or 1.1 degrees if it
// is motion-compensated at 27 m/s.
constexpr double kMostSpread_rad = 1.5 * kPi / 180.0;
// In a narrower range without points, the vehicle may block the view.
constexpr double kLeastGap_rad = kPi / 3.0;
// Relative difference between the period of rotation and the time between scans.
constexpr double kOtherPeriod = 0.2;
constexpr std::size_t kMinFarPoints = 25;  // of a ring
// Another frame explains the elevations if it reduces their spread to this share. In
// KITTI, moved to the frame of the body of NCLT, it reduces the spread to 0.04.
constexpr double kMaxSpreadShare = 0.25;

/// Returns a quantile. Reorders the values.
double find_quantile(std::vector<double>& values, double fraction) {
    const auto at = values.begin() + std::ptrdiff_t(fraction * double(values.size() - 1));
    std::nth_element(values.begin(), at, values.end());
    return *at;
}

/// First returns of a ring in a scan.
struct RingPoints {
    std::vector<std::size_t> point;   ///< index in the scan
    std::vector<double> azimuth_rad;  ///< [points]
};
using RingPointLists = std::vector<RingPoints>;

/// Returns the first returns of each ring with their azimuths.
RingPointLists group_rings(const LidarPoints& scan, std::size_t n_rings) {
    RingPointLists rings(n_rings);
    for (std::size_t i = 0; i < scan.size(); ++i) {
        if (!scan.return_number.empty() && scan.return_number[i] != 1) continue;
        rings[scan.ring[i]].point.push_back(i);
        const glm::vec3& position_m = scan.position_m[i];
        rings[scan.ring[i]].azimuth_rad.push_back(std::atan2(double(position_m.y), double(position_m.x)));
    }
    return rings;
}

/// Returns the elevations of each ring. Uses only the farther half of the points, because
/// beams start beside the sensor origin.
std::vector<std::vector<double>> far_elevations(std::span<const LidarPoints> scans, std::size_t n_rings) {
    struct RangeElevation {
        double range_m, elevation_rad;
    };
    std::vector<std::vector<RangeElevation>> samples_by_ring(n_rings);
    for (const LidarPoints& scan : scans)
        for (std::size_t i = 0; i < scan.size(); ++i) {
            const glm::dvec3 p(scan.position_m[i]);
            samples_by_ring[scan.ring[i]].push_back({glm::length(p), std::atan2(p.z, std::hypot(p.x, p.y))});
        }
    std::vector<std::vector<double>> elevations;
    for (std::vector<RangeElevation>& samples : samples_by_ring) {
        const auto half = samples.begin() + std::ptrdiff_t(samples.size() / 2);
        std::ranges::nth_element(samples, half, {}, &RangeElevation::range_m);
        std::vector<double>& far = elevations.emplace_back();
        for (auto s = half; s != samples.end(); ++s) far.push_back(s->elevation_rad);
    }
    return elevations;
}

/// Returns the median, over all rings, of 90th minus 10th percentile of the elevations.
double ring_spread(const LidarPoints& scan) {
    const std::size_t n_rings = scan.size() == 0 ? 0 : std::size_t(std::ranges::max(scan.ring)) + 1;
    std::vector<double> spreads;
    for (std::vector<double>& far : far_elevations({&scan, 1}, n_rings)) {
        if (far.size() < kMinFarPoints) continue;
        std::ranges::sort(far);
        spreads.push_back(far[far.size() * 9 / 10] - far[far.size() / 10]);
    }
    return spreads.empty() ? 0.0 : compute_median(std::move(spreads));
}

/// Fits the pose of a head, in the frame of the points, for which all points of a ring
/// have the same slope z / hypot(x, y). Uses Gauss-Newton steps. The yaw stays 0.
Pose fit_head(const LidarPoints& scan) {
    constexpr int kSteps = 6;
    constexpr double kMinDistance_m = 1.0;  // from the axis
    // derivatives of a slope by the position of the head and by its rotation about x and
    // y, and the slope
    using Row = Eigen::Matrix<double, 6, 1>;
    Pose head;
    for (int step = 0; step < kSteps; ++step) {
        const Pose head_from_frame = inverse(head);
        Eigen::Matrix<double, 6, 6> normal = Eigen::Matrix<double, 6, 6>::Zero();
        std::vector<std::pair<Row, double>> sums(std::size_t(std::ranges::max(scan.ring)) + 1,
                                                 {Row::Zero(), 0.0});  // [rings] rows and their number
        for (std::size_t i = 0; i < scan.size(); ++i) {
            const glm::dvec3 p = head_from_frame * glm::dvec3(scan.position_m[i]);
            const double rho = std::hypot(p.x, p.y), slope = p.z / rho;
            if (rho < kMinDistance_m) continue;
            const double turn = (1.0 + slope * slope) / rho;
            Row row;
            row << slope * p.x / (rho * rho), slope * p.y / (rho * rho), -1.0 / rho, -p.y * turn, p.x * turn,
                slope;
            normal += row * row.transpose();
            sums[scan.ring[i]].first += row;
            sums[scan.ring[i]].second += 1.0;
        }
        // Removes the mean slopes of the rings, which are unknown.
        for (const auto& [sum, n] : sums) normal -= sum * sum.transpose() / std::max(n, 1.0);
        const Eigen::Matrix<double, 5, 1> change =
            normal.topLeftCorner<5, 5>().ldlt().solve(-normal.topRightCorner<5, 1>());
        head = head * Pose{glm::normalize(glm::dquat(1.0, 0.5 * change[3], 0.5 * change[4], 0.0)),
                           {change[0], change[1], change[2]}};
    }
    return head;
}

/// Returns a text about the position of the sensor if the points fit a spinning sensor in
/// another frame, such as that of the vehicle. Otherwise, returns an empty text.
std::string describe_head(const LidarPoints& scan) {
    const Pose head = fit_head(scan), head_from_frame = inverse(head);
    LidarPoints moved = scan;
    for (glm::vec3& p : moved.position_m) p = glm::vec3(head_from_frame * glm::dvec3(p));
    if (!(ring_spread(moved) < kMaxSpreadShare * ring_spread(scan))) return "";
    const auto round_m = [](double value_m) { return std::round(100.0 * value_m) / 100.0 + 0.0; };  // not -0
    const glm::dvec3 axis = head.rotation * glm::dvec3(0.0, 0.0, 1.0);
    return fmt::format(
        "; the points fit a sensor whose centre is at ({:.2f}, {:.2f}, {:.2f}) m and whose axis is tilted by "
        "{:.1f} degrees: move all points to the frame of this sensor, and set \"vehicle_from_sensor\" in "
        "sequence.json to its pose",
        round_m(head.translation.x), round_m(head.translation.y), round_m(head.translation.z),
        std::acos(std::min(axis.z, 1.0)) * 180.0 / kPi);
}

/// Returns the widest azimuth range in which no scan has a point.
double widest_gap_rad(const std::vector<LidarPoints>& scans) {
    constexpr std::size_t kAzimuthBins = 360;
    std::array<bool, kAzimuthBins> is_bin_occupied{};
    for (const LidarPoints& scan : scans)
        for (const glm::vec3& p : scan.position_m) {
            const double azimuth_rad = std::atan2(double(p.y), double(p.x));
            const auto bin = std::size_t((azimuth_rad / (2.0 * kPi) + 0.5) * kAzimuthBins);
            is_bin_occupied[bin % kAzimuthBins] = true;
        }
    const CircularGap gap =
        find_widest_gap(kAzimuthBins, [&](std::size_t bin) { return is_bin_occupied[bin]; });
    return 2.0 * kPi * double(std::min(gap.length, kAzimuthBins)) / double(kAzimuthBins);
}

/// Estimates the number of columns per revolution from the lower quartile of the azimuth
/// steps, because steps across dropped rays are longer.
int estimate_columns(const LidarPoints& scan, const RingPointLists& rings) {
    std::vector<double> steps;
    for (const RingPoints& ring : rings) {
        std::vector<double> azimuths = ring.azimuth_rad;
        std::ranges::sort(azimuths);
        for (std::size_t i = 1; i < azimuths.size(); ++i) {
            const double step_rad = azimuths[i] - azimuths[i - 1];
            if (step_rad > kLeastStep_rad && step_rad < kLargestStep_rad) steps.push_back(step_rad);
        }
    }
    if (steps.size() < kFewestSteps)
        fail(
            "cannot estimate the beams from {} points in {} rings: found {} neighbours in a ring that are "
            "{:.2f} to {:.1f} degrees apart, expected at least {}",
            scan.size(), rings.size(), steps.size(), kLeastStep_rad * 180.0 / kPi,
            kLargestStep_rad * 180.0 / kPi, kFewestSteps);
    return int(std::lround(2.0 * kPi / find_quantile(steps, 0.25)));
}

/// Tests `n_counts` consecutive numbers N of columns. Returns the score of each: the sum
/// over the rings of |sum of exp(i N azimuth) over the points of the ring|. It is the
/// number of points if all azimuths of a ring are on a grid of N columns. The factor
/// exp(i N azimuth) of a point is multiplied by exp(i azimuth) for the next N.
std::vector<double> score_columns(const RingPointLists& rings, int first_column_count, std::size_t n_counts) {
    std::vector<double> scores(n_counts, 0.0);
    for (const RingPoints& ring : rings) {
        std::vector<std::complex<double>> factors, steps;  // [points]
        for (const double azimuth : ring.azimuth_rad) {
            factors.push_back(std::polar(1.0, first_column_count * azimuth));
            steps.push_back(std::polar(1.0, azimuth));
        }
        for (double& score : scores) {
            std::complex<double> sum = 0.0;
            for (std::size_t k = 0; k < factors.size(); ++k) {
                sum += factors[k];
                factors[k] *= steps[k];
            }
            score += std::abs(sum);
        }
    }
    return scores;
}

/// Azimuths at which a LiDAR fires: equal steps, with an offset for each ring.
struct FiringColumnGrid {
    int columns = 0;
    std::vector<double> offset_rad;  ///< [rings]
};

/// Raises an estimated number of columns to the number of points in the fullest ring, but
/// not by more than kMostColumns. A ring has at most one first return per column.
int raise_columns(int n_columns, const RingPointLists& rings) {
    std::size_t most = 0;
    for (const RingPoints& ring : rings) most = std::max(most, ring.point.size());
    return std::clamp(int(std::min<std::size_t>(most, kMaxRays)), n_columns, int(kMostColumns * n_columns));
}

/// Returns the azimuth offset of each ring from a grid of N columns. The phase of the sum
/// of exp(i N azimuth) over the points of a ring is N * offset, plus a shared phase.
std::vector<double> fit_ring_offsets(const RingPointLists& rings, int n_columns) {
    std::vector<std::complex<double>> sums(rings.size());
    for (std::size_t r = 0; r < rings.size(); ++r)
        for (const double azimuth : rings[r].azimuth_rad) sums[r] += std::polar(1.0, n_columns * azimuth);
    const std::complex<double> common = std::accumulate(sums.begin(), sums.end(), std::complex<double>(0.0));
    std::vector<double> offsets_rad(rings.size(), 0.0);
    for (std::size_t r = 0; r < rings.size(); ++r)
        if (sums[r] != 0.0) offsets_rad[r] = std::arg(sums[r] * std::conj(common)) / n_columns;
    return offsets_rad;
}

/// Estimates the number of columns and the azimuth offset of each ring. Searches around
/// the first estimate for the grid that the azimuths of all rings fit best. If they fit
/// no grid, for example after motion compensation, the offsets are 0.
FiringColumnGrid fit_firing_grid(const LidarPoints& scan, const RingPointLists& rings) {
    const int estimate = estimate_columns(scan, rings);
    const int margin = std::max(1, int(kColumnSearchMargin * estimate));
    const int first = std::max(1, estimate - margin), last = estimate + margin;
    const std::vector<double> scores = score_columns(rings, first, std::size_t(last + 1 - first));
    const auto best = std::ranges::max_element(scores);
    // A score is the number of points if all of them are on the grid.
    if (*best <= kMinCoherence * double(scan.size()))
        return {raise_columns(estimate, rings), std::vector<double>(rings.size(), 0.0)};
    const int n_columns = first + int(best - scores.begin());
    return {.columns = n_columns, .offset_rad = fit_ring_offsets(rings, n_columns)};
}

/// Returns the rotation rate of the LiDAR's head in radians per second, positive if
/// counterclockwise. Returns nothing if the points have no times.
std::optional<double> fit_rotation_rate(const LidarPoints& scan, const RingPointLists& rings) {
    if (scan.time_offset_s.empty()) return std::nullopt;
    // sums over pairs of consecutive points of a ring
    double turned_rad = 0.0, passed_s = 0.0;
    for (const RingPoints& ring : rings) {
        const auto time_of = [&](std::size_t index) { return scan.time_offset_s[ring.point[index]]; };
        std::vector<std::size_t> order(ring.point.size());
        std::iota(order.begin(), order.end(), std::size_t(0));
        std::ranges::sort(order, {}, time_of);
        for (std::size_t k = 1; k < order.size(); ++k) {
            const double step_rad =
                std::remainder(ring.azimuth_rad[order[k]] - ring.azimuth_rad[order[k - 1]], 2.0 * kPi);
            if (std::abs(step_rad) > kLargestStep_rad) continue;
            turned_rad += step_rad;
            passed_s += double(time_of(order[k])) - double(time_of(order[k - 1]));
        }
    }
    if (!(passed_s > 0.0) || turned_rad == 0.0) return std::nullopt;
    return turned_rad / passed_s;
}

/// Returns the number of rings of some scans.
/// @throws UsageError without rings or points, DataError if there are too many rings
std::size_t count_rings(const std::vector<LidarPoints>& scans) {
    std::size_t n_rings = 0;
    for (const LidarPoints& scan : scans) {
        if (scan.ring.size() != scan.size())
            fail<UsageError>("cannot estimate the beams: found {} ring numbers for {} points",
                             scan.ring.size(), scan.size());
        for (const std::uint16_t ring : scan.ring) n_rings = std::max(n_rings, std::size_t(ring) + 1);
    }
    if (n_rings == 0) throw UsageError("cannot estimate the beams: found no points, expected a few scans");
    if (n_rings > kMostRings)
        fail("cannot estimate the beams: found the ring number {}, expected one below {}", n_rings - 1,
             kMostRings);
    return n_rings;
}

}  // namespace

FittedSensor fit_spinning_sensor(const std::vector<LidarPoints>& scans, double period_s) {
    const std::size_t n_rings = count_rings(scans);
    // Columns are fitted to the scan with the most points, elevations to all scans.
    const LidarPoints& fullest = *std::ranges::max_element(scans, {}, &LidarPoints::size);
    const RingPointLists rings = group_rings(fullest, n_rings);
    const FiringColumnGrid grid = fit_firing_grid(fullest, rings);
    std::vector<std::vector<double>> far = far_elevations(scans, n_rings);
    std::vector<std::pair<double, std::size_t>> by_elevation;  // elevation and number of rings with points
    for (std::size_t r = 0; r < n_rings; ++r)
        if (!far[r].empty()) by_elevation.emplace_back(find_quantile(far[r], 0.5), r);
    // Beams are stored from the highest to the lowest.
    std::ranges::stable_sort(by_elevation, std::greater(), [](const auto& ring) { return ring.first; });
    FittedSensor fitted{{}, std::vector<std::uint16_t>(n_rings, kNoBeam)};
    SpinningSensor& sensor = fitted.sensor;
    for (const auto& [elevation_rad, r] : by_elevation) {
        fitted.beam_of_ring[r] = std::uint16_t(sensor.beams.size());
        sensor.beams.push_back({.elevation_rad = elevation_rad, .azimuth_offset_rad = grid.offset_rad[r]});
    }
    sensor.columns = grid.columns;
    // The sweep starts backward, half a column before the centre of the first column.
    sensor.first_azimuth_rad = kPi - kPi / grid.columns;
    const std::optional<double> rate = fit_rotation_rate(fullest, rings);
    sensor.period_s = rate ? 2.0 * kPi / std::abs(*rate) : period_s;
    sensor.clockwise = !rate || *rate < 0.0;  // Most heads turn clockwise.
    return fitted;
}

std::string why_not_spinning(const std::vector<LidarPoints>& scans, const SpinningSensor& fitted_sensor,
                             double frame_interval_s) {
    const auto fullest = std::ranges::max_element(scans, {}, &LidarPoints::size);
    if (fullest == scans.end()) return "";
    const double spread_rad = ring_spread(*fullest);
    if (spread_rad > kMostSpread_rad)
        return fmt::format(
            "the points of one ring differ in elevation by {:.1f} degrees; the usual causes are merged "
            "clouds of several LiDARs, wrong rings, or another frame{}",
            spread_rad * 180.0 / kPi, describe_head(*fullest));
    // A gap alone can be a limited field of view. It is an error only if the point
    // times also show another period than one revolution per scan.
    const double gap_rad = widest_gap_rad(scans);
    const bool has_other_period =
        !fullest->time_offset_s.empty() &&
        std::abs(fitted_sensor.period_s - frame_interval_s) >= kOtherPeriod * frame_interval_s;
    if (gap_rad < kLeastGap_rad || !has_other_period) return "";
    return fmt::format(
        "all points are within a sector of {:.0f} degrees of azimuth, and the times of the points show a "
        "revolution of {:.3f} s, but a revolution should take {:.3f} s",
        360.0 - gap_rad * 180.0 / kPi, fitted_sensor.period_s, frame_interval_s);
}

}  // namespace relidar
