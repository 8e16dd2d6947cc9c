// SPDX-License-Identifier: Apache-2.0
// The phase of a point is its azimuth in ticks. Points at multiples of the tick have
// equal phases. A beam that starts beside the axis adds an angle that depends on the
// range, and a rotation of the sensor adds an angle that grows with the time.
#include "read/scans/lattice_ticks.hpp"

#include <algorithm>
#include <complex>

#include "base/parallel.hpp"

namespace relidar::read {
namespace {

// The azimuths of nearer points are inaccurate, because beams start beside the axis.
constexpr double kMinYawDistance_m = 4.0;

/// Adds up the phases of points at neighbouring azimuths for each trial of the distance
/// by which their beam starts to the left of the axis. The trials have equal steps, so
/// each phase follows from the one before by a multiplication.
class PhaseTrials {
public:
    static constexpr int kTrials = 121;
    static constexpr double kStep_m = 0.001;
    static constexpr double left_m(int trial) { return (trial - kTrials / 2) * kStep_m; }

    /// @param rho_m  distance of the point from the axis
    void add(double azimuth_rad, double rho_m, int n_ticks) {
        std::complex<double> phase = std::polar(1.0, n_ticks * (azimuth_rad - left_m(0) / rho_m));
        const std::complex<double> step = std::polar(1.0, -n_ticks * kStep_m / rho_m);
        for (std::complex<double>& sum : sums_) {
            sum += phase;
            phase *= step;
        }
    }
    double length(int trial) const { return std::abs(sums_[std::size_t(trial)]); }

private:
    std::array<std::complex<double>, std::size_t(kTrials)> sums_{};
};

}  // namespace

std::vector<double> fit_left_offsets(const std::vector<LidarPoints>& sweeps, std::size_t n_rings,
                                     int n_ticks) {
    constexpr std::size_t kBins = 256;
    const std::size_t n_sweeps = std::min(kOffsetSweeps, sweeps.size());
    // [rings][sweeps][bins of the azimuth] azimuth and rho of each point
    std::vector<std::vector<glm::dvec2>> points_of_bin(n_rings * n_sweeps * kBins);
    for (std::size_t s = 0; s < n_sweeps; ++s)
        for (std::size_t i = 0; i < sweeps[s].size(); ++i) {
            const glm::dvec3 p(sweeps[s].position_m[i]);
            const double rho_m = axis_distance_m(p), azimuth_rad = azimuth_rad_of(p);
            if (rho_m < kMinYawDistance_m) continue;
            const auto bin = std::size_t((0.5 + azimuth_rad / kFullTurn_rad) * (kBins - 1));
            points_of_bin[(sweeps[s].ring[i] * n_sweeps + s) * kBins + bin].emplace_back(azimuth_rad, rho_m);
        }
    std::vector<double> left_m(n_rings, 0.0);
    parallel_for(int(n_rings), [&](int ring) {
        // A sum of phases is longest if they are equal, which the right trial makes them.
        std::array<double, std::size_t(PhaseTrials::kTrials)> lengths{};
        const std::size_t first = std::size_t(ring) * n_sweeps * kBins;
        for (std::size_t bin = first; bin < first + n_sweeps * kBins; ++bin) {
            PhaseTrials trials;
            for (const glm::dvec2& point : points_of_bin[bin]) trials.add(point.x, point.y, n_ticks);
            for (int t = 0; t < PhaseTrials::kTrials; ++t) lengths[std::size_t(t)] += trials.length(t);
        }
        const auto longest = std::ranges::max_element(lengths);
        if (*longest > 0.0) left_m[std::size_t(ring)] = PhaseTrials::left_m(int(longest - lengths.begin()));
    });
    return left_m;
}

YawFit fit_yaw(const std::vector<FiredPoint>& points, const std::vector<std::uint16_t>& rings,
               const HeadTurn& turn, int n_ticks, const std::vector<double>& left_m) {
    // A bin is 1/256 of the turn. Each bin of a ring has the sum of its points' phases.
    constexpr std::size_t kBins = 256, kMaxLag = 32;
    const std::size_t n_rings = std::size_t(std::ranges::max(rings)) + 1;
    std::vector<std::complex<double>> phases(n_rings * kBins);  // [rings][bins]
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::dvec3& p = points[i].position_m;
        const double rho = axis_distance_m(p);
        if (rho < kMinYawDistance_m || rings[i] >= left_m.size()) continue;
        const auto bin = std::size_t(std::clamp((points[i].turn + turn.reference) * kBins, 0.0, kBins - 1.0));
        phases[rings[i] * kBins + bin] +=
            std::polar(1.0, n_ticks * (azimuth_rad_of(p) - left_m[rings[i]] / rho));
    }
    const auto reference_bin = std::size_t(std::clamp(turn.reference * kBins, 0.0, double(kBins)));
    YawFit fit;
    // length of the sum of phase differences, and its value if all of them are equal
    double joint = 0.0, possible = 0.0;
    for (std::size_t half = 0; half < 2; ++half) {
        const std::size_t begin = half == 0 ? 0 : reference_bin, end = half == 0 ? reference_bin : kBins;
        std::complex<double> sum = 0.0;
        double possible_length = 0.0;
        // A rotation by r rad in a turn changes the phase by n_ticks * r * lag / kBins
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
            const double turns = double(lag) / kBins, predicted = n_ticks * fit.turned_rad[half] * turns,
                         remaining = std::arg(sum * std::polar(1.0, -predicted));
            fit.turned_rad[half] += remaining / (n_ticks * turns);
        }
        joint += std::abs(sum);  // of the largest lag
        possible += possible_length;
    }
    // A half that is too short for a lag turns like the other one.
    if (reference_bin < 2) fit.turned_rad[0] = fit.turned_rad[1];
    if (reference_bin + 2 > kBins) fit.turned_rad[1] = fit.turned_rad[0];
    fit.coherence = possible > 0.0 ? joint / possible : 0.0;
    return fit;
}

}  // namespace relidar::read
