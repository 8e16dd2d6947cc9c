// SPDX-License-Identifier: Apache-2.0
// Groups the rays of a scan by firing (all lasers at one azimuth), because a packet
// stores complete firings. In a range image, firing f of a beam is stored in the column f
// - offset_columns(beam).
#include <algorithm>
#include <cmath>
#include <complex>
#include <optional>

#include <relidar/base/math.hpp>

#include "base/fail.hpp"
#include "log/sensor/beam_geometry.hpp"
#include "read/packets/packet_format.hpp"

namespace relidar::packets {
namespace {

constexpr double kMinRevolutionFraction = 0.05;  // minimum part of a turn that a scan must cover
constexpr double kSameFiring_us = 1.0;           // columns that are nearer in time are one firing
// distance at which the direction of a ray without a return is computed
constexpr double kProbeRange_m = 1e4;

/// Finds the ray of each ring in a firing of a scan.
class FiringRays {
public:
    FiringRays(const Scan& scan, const SpinningSensor& sensor) : image_columns_(scan.rays.columns) {
        if (scan.rays.rows != int(sensor.beams.size()) || image_columns_ < 1)
            fail<UsageError>(
                "cannot write packets of {}: the scan has {} rows, expected one row for each of the {} beams",
                sensor.name, scan.rays.rows, sensor.beams.size());
        // Inside a limited field of view, the image has only the columns that fire.
        if (sensor.azimuth_rad) {
            place_.resize(std::size_t(sensor.columns));
            const std::vector<int> fired = fired_columns(sensor);
            for (std::size_t i = 0; i < fired.size(); ++i) place_[std::size_t(fired[i])] = i;
        }
        for (const Beam& beam : sensor.beams) shift_.push_back(offset_columns(beam, n_firings()));
    }
    std::size_t n_rings() const { return shift_.size(); }
    int n_firings() const { return place_.empty() ? image_columns_ : int(place_.size()); }
    /// Returns the index of a ray. No value if it is outside the field of view.
    std::optional<std::size_t> ray_at(std::size_t ring, int firing) const {
        const int n = n_firings(), column = ((firing - shift_[ring]) % n + n) % n;
        const std::optional<std::size_t> place =
            place_.empty() ? std::size_t(column) : place_[std::size_t(column)];
        if (!place) return {};
        return ring * std::size_t(image_columns_) + *place;
    }

private:
    int image_columns_;
    /// [columns of a turn] columns of the image; empty if they are equal
    std::vector<std::optional<std::size_t>> place_;
    std::vector<int> shift_;  ///< [rings] number of the firing minus its column in a turn
};

/// Returns how badly the delays fit: after subtracting `beam_delays_us`, all rays of a
/// firing should have the same time. Sums the difference between the latest and the
/// earliest time over all firings.
double time_spread_us(const Scan& scan, const FiringRays& rays, const std::vector<double>& beam_delays_us) {
    double sum_us = 0.0;
    for (int firing = 0; firing < rays.n_firings(); ++firing) {
        double first_us = INFINITY, last_us = -INFINITY;
        for (std::size_t ring = 0; ring < rays.n_rings(); ++ring) {
            const std::optional<std::size_t> ray = rays.ray_at(ring, firing);
            if (!ray || scan.range_m[*ray] <= 0.0f) continue;
            const double time_us = 1e6 * double(scan.rays.time_offset_s[*ray]) - beam_delays_us[ring];
            first_us = std::min(first_us, time_us);
            last_us = std::max(last_us, time_us);
        }
        if (last_us > first_us) sum_us += last_us - first_us;
    }
    return sum_us;
}

/// Returns a firing with the returns of its rays, without time and azimuth.
FiringColumn copy_returns(const Scan& scan, const FiringRays& firing_rays, int firing_index) {
    FiringColumn column{.returns = {}};
    column.returns.resize(firing_rays.n_rings());
    for (std::size_t ring = 0; ring < firing_rays.n_rings(); ++ring) {
        const std::optional<std::size_t> ray = firing_rays.ray_at(ring, firing_index);
        if (!ray) continue;
        column.is_measured = true;
        auto& [first, second] = column.returns[ring];
        first = {scan.range_m[*ray], scan.intensity[*ray]};
        if (!scan.second_returns.empty())
            second = {scan.second_returns[0].range_m[*ray], scan.second_returns[0].intensity[*ray]};
        if (first.range_m > 0.0f) column.has_returns = true;
    }
    return column;
}

/// Joins the rays of a firing. Its time is the mean time of the rays without the delays
/// of their beams. Its azimuth is the mean azimuth of the head at which the beams have
/// the directions of the rays. Uses only rays with a return, because their directions are
/// measured. Uses all rays if none has a return.
FiringColumn join_rays(const Scan& scan, const FiringRays& firing_rays, int firing_index,
                       const std::vector<BeamRays>& beams, const std::vector<double>& beam_delays_us) {
    FiringColumn column = copy_returns(scan, firing_rays, firing_index);
    std::complex<double> sum_of_heads = 0.0;  // unit vectors
    std::size_t n_used = 0;
    for (std::size_t ring = 0; ring < firing_rays.n_rings(); ++ring) {
        const std::optional<std::size_t> ray = firing_rays.ray_at(ring, firing_index);
        if (!ray) continue;
        const double range_m = column.has_returns ? double(scan.range_m[*ray]) : kProbeRange_m;
        if (range_m <= 0.0) continue;
        const glm::dvec3 point_m =
            glm::dvec3(scan.rays.origin[*ray]) + glm::dvec3(scan.rays.direction[*ray]) * range_m;
        sum_of_heads += std::polar(1.0, beams[ring].azimuth_facing(point_m));
        column.time_s += double(scan.rays.time_offset_s[*ray]) - 1e-6 * beam_delays_us[ring];
        ++n_used;
    }
    column.time_s /= double(std::max<std::size_t>(n_used, 1));
    // Azimuths of scans count counterclockwise, those of packets clockwise.
    column.azimuth_deg = std::fmod(360.0 - std::arg(sum_of_heads) * 180.0 / kPi, 360.0);
    return column;
}

/// Sets the times of firings without returns, because a log has no measured times of
/// them. Uses the nearest firing with a return, and the rotation between the two.
void time_empty_firings(std::vector<FiringColumn>& firings, double rotation_period_s) {
    std::vector<std::ptrdiff_t> timed;  // indices of the firings with returns
    for (std::size_t i = 0; i < firings.size(); ++i)
        if (firings[i].has_returns) timed.push_back(std::ptrdiff_t(i));
    if (timed.empty()) return;
    for (std::ptrdiff_t i = 0; i < std::ssize(firings); ++i) {
        FiringColumn& column = firings[std::size_t(i)];
        if (column.has_returns) continue;
        const auto after = std::ranges::upper_bound(timed, i);
        const bool is_after_nearer =
            after == timed.begin() || (after != timed.end() && *after - i < i - *(after - 1));
        const FiringColumn& nearest = firings[std::size_t(is_after_nearer ? *after : *(after - 1))];
        // from the nearest firing, backward if it is later
        double turned_deg = std::fmod(column.azimuth_deg - nearest.azimuth_deg + 720.0, 360.0);
        if (is_after_nearer) turned_deg -= 360.0;
        column.time_s = nearest.time_s + turned_deg / 360.0 * rotation_period_s;
    }
}

/// Sorts firings by the rotation angle of the head. Times in a log are not exact, so they
/// only decide in which turn a firing is.
void sort_by_rotation(std::vector<FiringColumn>& firings, double rotation_period_s) {
    const FiringColumn middle = firings[firings.size() / 2];
    const auto turns_since_middle = [&](const FiringColumn& firing) {
        const double by_angle = (firing.azimuth_deg - middle.azimuth_deg) / 360.0;  // without full turns
        const double by_time = (firing.time_s - middle.time_s) / rotation_period_s;
        return by_angle + std::round(by_time - by_angle);
    };
    std::ranges::stable_sort(firings, {}, turns_since_middle);
}

}  // namespace

std::vector<FiringColumn> extract_firings(const Scan& scan, double scan_time_s, const SpinningSensor& sensor,
                                          const std::vector<double>& beam_delays_us) {
    const FiringRays image(scan, sensor);
    const auto [first, last] = std::ranges::minmax(scan.rays.time_offset_s);
    if (!(double(last - first) > kMinRevolutionFraction * sensor.period_s))
        fail<UsageError>(
            "cannot write packets of {}: the rays of a scan were fired within {:.3g} s, expected {:.3g} s; "
            "motion-compensated scans have no firing times",
            sensor.name, last - first, sensor.period_s);
    // In a recorded scan, ray times include the firing delay of each laser. In a rendered
    // scan, all lasers fire simultaneously. Uses what gives firings of one time.
    const std::vector<double> no_delays(beam_delays_us.size(), 0.0);
    const bool is_recorded =
        time_spread_us(scan, image, beam_delays_us) < time_spread_us(scan, image, no_delays);
    const std::vector<double>& delays_us = is_recorded ? beam_delays_us : no_delays;
    const std::vector<BeamRays> beams = make_generators(sensor.beams);
    std::vector<FiringColumn> columns;
    for (int firing = 0; firing < image.n_firings(); ++firing)
        columns.push_back(join_rays(scan, image, firing, beams, delays_us));
    // Firings outside the field of view have no rays. Those without a return have no
    // measured time in a recorded scan.
    std::erase_if(columns, [](const FiringColumn& column) { return !column.is_measured; });
    if (is_recorded) time_empty_firings(columns, sensor.period_s);
    sort_by_rotation(columns, sensor.period_s);
    // A log may contain the same firing in two columns. Removes the second copy.
    const auto repeats = std::ranges::unique(columns, [](const FiringColumn& a, const FiringColumn& b) {
        return 1e6 * std::abs(a.time_s - b.time_s) < kSameFiring_us;
    });
    columns.erase(repeats.begin(), repeats.end());
    // Times of rays are relative to the scan.
    for (FiringColumn& column : columns) column.time_s += scan_time_s;
    return columns;
}

}  // namespace relidar::packets
