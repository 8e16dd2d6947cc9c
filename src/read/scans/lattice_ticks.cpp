// SPDX-License-Identifier: Apache-2.0
#include "read/scans/lattice_ticks.hpp"

#include <algorithm>
#include <complex>
#include <span>

#include "base/parallel.hpp"

namespace relidar::read {
namespace {

// The azimuths of nearer points are inaccurate, because beams start beside the axis.
constexpr double kMinYawDistance_m = 4.0;

/// Returns the distance by which a beam starts to the left of the axis. At the distance
/// rho, this adds left / rho to the azimuth. The head fires at multiples of 2 pi /
/// n_ticks, so the factors exp(i n_ticks (azimuth - left / rho)) are equal, and their sum
/// is longest. Tries many values of left, and adds the lengths of the sums of all bins.
/// @param bins  azimuth and rho of the points, in bins of neighbouring azimuths
double find_left_offset(std::span<const std::vector<glm::dvec2>> bins, int n_ticks) {
    constexpr std::size_t kTrials = 121;
    constexpr double kStep_m = 0.001;
    const auto left_m = [](std::size_t trial) { return (int(trial) - int(kTrials / 2)) * kStep_m; };
    std::array<double, kTrials> lengths{};
    for (const std::vector<glm::dvec2>& points : bins) {
        std::array<std::complex<double>, kTrials> sums{};
        for (const glm::dvec2& point : points) {
            const double azimuth_rad = point.x, rho_m = point.y;
            std::complex<double> factor = std::polar(1.0, n_ticks * (azimuth_rad - left_m(0) / rho_m));
            // from the factor of a trial to that of the next, because the steps are equal
            const std::complex<double> step = std::polar(1.0, -n_ticks * kStep_m / rho_m);
            for (std::complex<double>& sum : sums) {
                sum += factor;
                factor *= step;
            }
        }
        for (std::size_t trial = 0; trial < kTrials; ++trial) lengths[trial] += std::abs(sums[trial]);
    }
    const auto longest = std::ranges::max_element(lengths);
    return *longest > 0.0 ? left_m(std::size_t(longest - lengths.begin())) : 0.0;
}

}  // namespace

std::vector<double> fit_left_offsets(const std::vector<LidarPoints>& sweeps, std::size_t n_rings,
                                     int n_ticks) {
    constexpr std::size_t kBins = 256;
    const std::size_t n_sweeps = std::min(kOffsetSweeps, sweeps.size());
    // [rings][sweeps][bins of the azimuth] azimuth and distance from the axis (rho) of
    // each point. The yaw of the sensor hardly changes within a bin.
    std::vector<std::vector<glm::dvec2>> points_of_bin(n_rings * n_sweeps * kBins);
    for (std::size_t s = 0; s < n_sweeps; ++s)
        for (std::size_t i = 0; i < sweeps[s].size(); ++i) {
            const glm::dvec3 p(sweeps[s].position_m[i]);
            const double rho_m = axis_distance_m(p), azimuth_rad = azimuth_rad_of(p);
            if (rho_m < kMinYawDistance_m) continue;
            const auto bin = std::size_t((0.5 + azimuth_rad / kFullTurn_rad) * (kBins - 1));
            points_of_bin[(sweeps[s].ring[i] * n_sweeps + s) * kBins + bin].emplace_back(azimuth_rad, rho_m);
        }
    std::vector<double> left_m(n_rings);
    const std::size_t n_bins = n_sweeps * kBins;  // of a ring
    parallel_for(int(n_rings), [&](int ring) {
        const auto bins = std::span(points_of_bin).subspan(std::size_t(ring) * n_bins, n_bins);
        left_m[std::size_t(ring)] = find_left_offset(bins, n_ticks);
    });
    return left_m;
}

YawFit fit_yaw(const std::vector<FiredPoint>& points, const std::vector<std::uint16_t>& rings,
               const HeadTurn& turn, const HeadTicks& ticks) {
    // A bin is 1/256 of the turn. Each bin of a ring has the sum of its points' phases.
    constexpr std::size_t kBins = 256, kMaxLag = 32;
    const std::size_t n_rings = std::size_t(std::ranges::max(rings)) + 1;
    std::vector<std::complex<double>> phases(n_rings * kBins);  // [rings][bins]
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::dvec3& p = points[i].position_m;
        const double rho = axis_distance_m(p);
        if (rho < kMinYawDistance_m || rings[i] >= ticks.left_m.size()) continue;
        const double since_start_turns = points[i].time_turns - turn.start_turns;
        const auto bin = std::size_t(std::clamp(since_start_turns * kBins, 0.0, kBins - 1.0));
        phases[rings[i] * kBins + bin] +=
            std::polar(1.0, ticks.n * (azimuth_rad_of(p) - ticks.left_m[rings[i]] / rho));
    }
    const auto frame_bin = std::size_t(std::clamp(-turn.start_turns * kBins, 0.0, double(kBins)));
    YawFit fit;
    // length of the sum of phase differences, and its value if all of them are equal
    double joint = 0.0, possible = 0.0;
    for (std::size_t half = 0; half < 2; ++half) {
        const std::size_t begin = half == 0 ? 0 : frame_bin, end = half == 0 ? frame_bin : kBins;
        std::complex<double> sum = 0.0;
        double possible_length = 0.0;
        // A rotation by r rad in a turn changes the phase by ticks.n * r * lag / kBins
        // between bins at a distance of `lag`. The change is known only within +-pi, so
        // the rotation from one lag predicts it for the next, which is more exact.
        for (std::size_t lag = 1; lag <= kMaxLag && 2 * lag <= end - begin; lag *= 2) {
            sum = possible_length = 0.0;
            for (std::size_t r = 0; r < n_rings; ++r)
                for (std::size_t b = begin; b + lag < end; ++b) {
                    const std::complex<double> first = phases[r * kBins + b],
                                               second = phases[r * kBins + b + lag];
                    sum += second * std::conj(first);
                    possible_length += std::abs(first) * std::abs(second);
                }
            const double turns = double(lag) / kBins, predicted = ticks.n * fit.turned_rad[half] * turns,
                         remaining = std::arg(sum * std::polar(1.0, -predicted));
            fit.turned_rad[half] += remaining / (ticks.n * turns);
        }
        joint += std::abs(sum);  // of the largest lag
        possible += possible_length;
    }
    // A half that is too short for a lag turns like the other one.
    if (frame_bin < 2) fit.turned_rad[0] = fit.turned_rad[1];
    if (frame_bin + 2 > kBins) fit.turned_rad[1] = fit.turned_rad[0];
    fit.coherence = possible > 0.0 ? joint / possible : 0.0;
    return fit;
}

}  // namespace relidar::read
