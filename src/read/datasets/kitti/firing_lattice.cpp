// SPDX-License-Identifier: Apache-2.0
// Fits the firing angles of an HDL-64E in two steps. The first step fits the tick size of
// the encoder and the left offset of each beam, so that the azimuths of a beam are close
// to multiples of the tick size:
//   max over tick, left of | mean exp(2 pi i (azimuth - asin(left / rho)) / tick) |
// The second step fits the azimuth offset of each beam, in full ticks. It maximises the
// number of ticks at which a beam and other beams have returns.
#include "read/datasets/kitti/firing_lattice.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <numeric>

#include <relidar/base/math.hpp>
#include "base/median.hpp"
#include "base/parallel.hpp"
#include "log/sensor/beam_geometry.hpp"

namespace relidar::kitti {
namespace {

// maximum azimuth offset of a beam from the head; real HDL-64Es have at most 0.16 rad
constexpr double kMaxOffset_rad = 0.35;
// A firing has returns of at least this many beams. Fewer can be stray points.
constexpr int kMinLasers = 4;

struct PolarPoints {
    std::vector<double> azimuth_rad, inverse_rho;
};

/// Converts the points of all scans to polar coordinates, grouped by ring.
std::array<PolarPoints, kRings> collect_polar(const std::vector<const RingScan*>& scans) {
    std::array<PolarPoints, kRings> polar;
    for (const RingScan* scan : scans)
        for (std::size_t i = 0; i < scan->points.size(); ++i) {
            const glm::dvec4 p(scan->points[i]);
            const double rho = std::hypot(p.x, p.y);
            // The files are rounded to a millimetre, so azimuths of near points are
            // inaccurate.
            if (rho < 2.0) continue;
            polar[scan->ring[i]].azimuth_rad.push_back(std::atan2(p.y, p.x));
            polar[scan->ring[i]].inverse_rho.push_back(1.0 / rho);
        }
    return polar;
}

/// Returns the mean of exp(2 pi i (azimuth - lateral_offset_m / distance) / tick) over
/// every `point_stride`-th point. Its argument is the phase of the azimuths; its absolute
/// value is 1 if all points fit the ticks.
std::complex<double> mean_tick_phase(const PolarPoints& beam_points, double encoder_tick_rad,
                                     double lateral_offset_m, std::size_t point_stride) {
    std::complex<double> sum = 0.0;
    std::size_t n = 0;
    for (std::size_t i = 0; i < beam_points.azimuth_rad.size(); i += point_stride, ++n)
        sum += std::polar(
            1.0, 2.0 * kPi * (beam_points.azimuth_rad[i] - lateral_offset_m * beam_points.inverse_rho[i]) /
                     encoder_tick_rad);
    return n > 0 ? sum / double(n) : sum;
}

/// Model of a beam: azimuth = tick + phase_rad + left_m / distance from the spin axis.
/// `concentration` is the quality of the fit, 0 to 1.
struct TickGridPhase {
    double left_m = 0.0, phase_rad = 0.0, concentration = 0.0;
};

/// Improves a fit by least squares of azimuth = n * encoder_tick_rad + phase_rad + left_m
/// / distance, with integer n.
void refine_phase(TickGridPhase& phase, const PolarPoints& polar, double encoder_tick_rad) {
    double n = 0, su = 0, se = 0, suu = 0, sue = 0;
    for (std::size_t i = 0; i < polar.azimuth_rad.size(); ++i) {
        const double u = polar.inverse_rho[i];
        const double e =
            std::remainder(polar.azimuth_rad[i] - phase.left_m * u - phase.phase_rad, encoder_tick_rad);
        // Points in the middle between two ticks are outliers.
        if (std::abs(e) > 0.25 * encoder_tick_rad) continue;
        n += 1;
        su += u;
        se += e;
        suu += u * u;
        sue += u * e;
    }
    const double spread = n * suu - su * su;
    // At similar distances, the lateral offset cannot be separated from the azimuth
    // offset.
    if (n < 16 || spread < 1e-4 * n * n) return;
    const double left = (n * sue - su * se) / spread;
    phase.left_m += left;
    phase.phase_rad += (se - left * su) / n;
}

/// Fits the left offset and the azimuth phase of one beam. Tries left offsets in steps of
/// 2 mm, and then refines the best one.
TickGridPhase fit_beam_phase(const PolarPoints& polar, double encoder_tick_rad) {
    TickGridPhase best;
    // About 500 points are enough to compare the offsets.
    const std::size_t stride = std::max<std::size_t>(polar.azimuth_rad.size() / 500, 1);
    for (int mm = -60; mm <= 60; mm += 2) {
        const std::complex<double> mean = mean_tick_phase(polar, encoder_tick_rad, mm * 1e-3, stride);
        // Searches from -60 to 60 mm and keeps the offset that fits the encoder ticks
        // best.
        const double gain = std::abs(mean) - best.concentration;
        if (mm == -60 || gain > 0.0)
            best = {mm * 1e-3, std::arg(mean) * encoder_tick_rad / (2.0 * kPi), std::abs(mean)};
    }
    // Prefers offset 0 if it fits nearly as well.
    const std::complex<double> none = mean_tick_phase(polar, encoder_tick_rad, 0.0, stride);
    if (std::abs(none) > best.concentration - 0.02)
        best = {0.0, std::arg(none) * encoder_tick_rad / (2.0 * kPi), std::abs(none)};
    if (best.left_m != 0.0) refine_phase(best, polar, encoder_tick_rad);
    return best;
}

struct RingPhases {
    std::array<TickGridPhase, kRings> ring;
    double concentration = 0.0;  ///< mean over the points
};

/// Fits the phase of every beam to ticks of one size. Returns also the mean quality of
/// all fits.
RingPhases fit_phases(const std::array<PolarPoints, kRings>& polar_rings, double encoder_tick_rad) {
    RingPhases phases;
    parallel_for(kRings, [&](int k) {
        const std::size_t at = std::size_t(k);
        phases.ring[at] = fit_beam_phase(polar_rings[at], encoder_tick_rad);
    });
    double n = 0;
    for (std::size_t k = 0; k < kRings; ++k) {
        n += double(polar_rings[k].azimuth_rad.size());
        phases.concentration += phases.ring[k].concentration * double(polar_rings[k].azimuth_rad.size());
    }
    phases.concentration /= std::max(n, 1.0);
    return phases;
}

/// Estimates the firings per revolution from the mean azimuth step between consecutive
/// points of a beam. Ignores steps longer than 1.5 times the median, because there are
/// dropped rays in between.
int estimate_firings(const std::vector<const RingScan*>& scans) {
    std::vector<double> steps;
    for (const RingScan* scan : scans)
        for (std::size_t i = 1; i < scan->points.size(); ++i) {
            const glm::dvec4 a(scan->points[i - 1]), b(scan->points[i]);
            const double step = std::atan2(a.x * b.y - a.y * b.x, a.x * b.x + a.y * b.y);
            if (scan->ring[i] == scan->ring[i - 1] && step > 1e-5) steps.push_back(step);
        }
    if (steps.empty()) return 1;
    const double longest = 1.5 * compute_median(steps);
    double sum = 0.0, n = 0.0;
    for (const double s : steps)
        if (s < longest) {
            sum += s;
            n += 1.0;
        }
    return std::max(int(std::lround(2.0 * kPi * n / sum)), 1);
}

using BeamTicks = std::vector<std::vector<int>>;

/// Returns the encoder ticks of all points of a scan, grouped by beam. A tick is the head
/// position at which the beam of the point faced the point.
BeamTicks compute_ticks(const RingScan& scan, const FiringGrid& firing_grid) {
    BeamTicks ticks(kRings);
    std::vector<BeamRays> beams;
    for (std::size_t k = 0; k < kRings; ++k)
        beams.emplace_back(
            Beam{.azimuth_offset_rad = firing_grid.offset_rad[k], .origin_left_m = firing_grid.left_m[k]});
    for (std::size_t i = 0; i < scan.points.size(); ++i) {
        const std::size_t k = scan.ring[i];
        ticks[k].push_back(
            firing_grid.head.nearest_tick(beams[k].azimuth_facing(glm::dvec3(scan.points[i]))));
    }
    return ticks;
}

/// Returns [scans][ticks] flags. A flag is true if at least `min_beams` beams have a
/// return at the tick (azimuth step of the rotary encoder).
/// @param tick_shift_of_each_beam  [beams] subtracted from the tick of each return of the
/// beam
std::vector<std::vector<char>> flag_fired_ticks(const std::vector<BeamTicks>& ticks_of_scans,
                                                const std::vector<int>& tick_shift_of_each_beam, int n_ticks,
                                                int min_beams) {
    std::vector<std::vector<char>> pattern;
    for (const BeamTicks& scan : ticks_of_scans) {
        std::vector<int> count(static_cast<std::size_t>(n_ticks));
        for (std::size_t k = 0; k < kRings; ++k)
            for (const int t : scan[k])
                ++count[std::size_t(((t - tick_shift_of_each_beam[k]) % n_ticks + n_ticks) % n_ticks)];
        std::vector<char>& yes = pattern.emplace_back(std::size_t(n_ticks));
        for (std::size_t t = 0; t < count.size(); ++t) yes[t] = count[t] >= min_beams;
    }
    return pattern;
}

/// Moves a tick into [0, n_ticks). The argument is at most one turn outside of this
/// range.
int wrap_tick(int tick, int n_ticks) {
    if (tick < 0) return tick + n_ticks;
    return tick >= n_ticks ? tick - n_ticks : tick;
}

/// Returns the azimuth offset of a beam in encoder ticks, which is later subtracted from
/// its ticks. The best offset moves the most returns to ticks at which other beams have
/// returns. Returns 0 if no offset is clearly better than 0.
/// @param is_tick_fired  [scans][ticks] true if other beams have returns at the tick
int find_tick_offset(const std::vector<BeamTicks>& ticks_of_scans, std::size_t ring,
                     const std::vector<std::vector<char>>& is_tick_fired, int n_ticks, int max_shift) {
    std::size_t n = 0;
    for (const BeamTicks& scan : ticks_of_scans) n += scan[ring].size();
    std::size_t most = 0, at_zero = 0;
    int best = 0;
    for (int i = 0; i <= 2 * max_shift; ++i) {
        // Tries 0, -1, 1, -2, 2 and so on, so that the smallest of several equal offsets
        // wins.
        const int shift = i % 2 == 0 ? i / 2 : -(i + 1) / 2;
        std::size_t hits = 0;
        for (std::size_t s = 0; s < ticks_of_scans.size(); ++s)
            for (const int t : ticks_of_scans[s][ring]) {
                const int moved = wrap_tick(t - shift, n_ticks);
                hits += std::size_t(is_tick_fired[s][std::size_t(moved)]);
            }
        if (i == 0) at_zero = hits;
        if (hits > most) {
            most = hits;
            best = shift;
        }
    }
    return most > at_zero + n / 100 ? best : 0;
}

/// Returns the azimuth offset of each beam in encoder ticks. All beams fire together, so
/// correct offsets move the returns of a firing to the same tick.
std::vector<int> find_tick_shifts(const std::vector<BeamTicks>& ticks_of_scans, int n_ticks) {
    const int reach = std::min(int(kMaxOffset_rad / (2.0 * kPi) * n_ticks), n_ticks / 2 - 1);
    std::size_t fullest = 0;
    for (std::size_t k = 1; k < kRings; ++k)
        if (ticks_of_scans[0][k].size() > ticks_of_scans[0][fullest].size()) fullest = k;
    std::vector<BeamTicks> reference = ticks_of_scans;
    for (BeamTicks& scan : reference)
        for (std::size_t k = 0; k < kRings; ++k)
            if (k != fullest) scan[k].clear();
    std::vector<int> shift(kRings, 0);
    auto pattern = flag_fired_ticks(reference, shift, n_ticks, 1);
    // Each pass shifts each beam in azimuth, so that its returns are at the ticks that
    // `pattern` marks. Pass 1 uses the ticks of the beam with the most points. Pass 2
    // uses the ticks at which at least kMinLasers beams have returns after pass 1.
    for (int pass = 0; pass < 2; ++pass) {
        parallel_for(kRings, [&](int k) {
            shift[std::size_t(k)] = find_tick_offset(ticks_of_scans, std::size_t(k), pattern, n_ticks, reach);
        });
        pattern = flag_fired_ticks(ticks_of_scans, shift, n_ticks, kMinLasers);
    }
    return shift;
}

}  // namespace

std::vector<Beam> FiringGrid::make_beams(const BeamCones& cones) const {
    std::vector<Beam> beams(kRings);
    for (std::size_t k = 0; k < kRings; ++k) {
        const double elevation = std::atan(cones[k].slope);
        beams[k] = {elevation, offset_rad[k], 0.0, cones[k].at_zero * std::cos(elevation), left_m[k]};
    }
    return beams;
}

FiringGrid fit_firing_grid(const std::vector<const RingScan*>& scans) {
    // Minimum quality of the fit of the azimuths to the ticks. It is 1 if all azimuths
    // are exactly on ticks, and 0 if they are unrelated to the ticks.
    constexpr double kMinConcentration = 0.8;
    const std::array<PolarPoints, kRings> polar = collect_polar(scans);
    FiringGrid lattice;
    lattice.head.n_ticks = kEncoderTicks;
    RingPhases phases = fit_phases(polar, 2.0 * kPi / kEncoderTicks);
    // If the azimuths do not fit the encoder of a real HDL-64E, tries equal azimuth steps
    // instead.
    if (phases.concentration < kMinConcentration) {
        lattice.head.n_ticks = estimate_firings(scans);
        lattice.every_tick = true;
        phases = fit_phases(polar, 2.0 * kPi / lattice.head.n_ticks);
    }
    if (phases.concentration < kMinConcentration) return lattice;

    for (std::size_t k = 0; k < kRings; ++k) {
        lattice.left_m[k] = phases.ring[k].left_m;
        lattice.offset_rad[k] = phases.ring[k].phase_rad;
    }
    if (!lattice.every_tick) {
        std::vector<BeamTicks> ticks;
        for (const RingScan* scan : scans) ticks.push_back(compute_ticks(*scan, lattice));
        const std::vector<int> shift = find_tick_shifts(ticks, lattice.head.n_ticks);
        for (std::size_t k = 0; k < kRings; ++k)
            lattice.offset_rad[k] += shift[k] * lattice.head.tick_step_rad();
    }
    // Shifts the offsets of all beams so that their mean is 0. The head then faces the
    // mean direction of the beams.
    const double mean_rad =
        std::accumulate(lattice.offset_rad.begin(), lattice.offset_rad.end(), 0.0) / kRings;
    for (double& offset_rad : lattice.offset_rad) offset_rad -= mean_rad;
    lattice.head.zero_rad += mean_rad;
    return lattice;
}

std::vector<int> find_fired_ticks(const RingScan& scan, const FiringGrid& firing_grid) {
    // compute_ticks() has applied the beam offsets, so the shifts are 0.
    const auto pattern = flag_fired_ticks({compute_ticks(scan, firing_grid)}, std::vector<int>(kRings, 0),
                                          firing_grid.head.n_ticks, kMinLasers);
    std::vector<int> firings;
    for (int t = 0; t < firing_grid.head.n_ticks; ++t)
        if (firing_grid.every_tick || pattern[0][std::size_t(t)]) firings.push_back(t);
    std::sort(firings.begin(), firings.end(), [&](int first, int second) {
        return firing_grid.head.tick_azimuth_rad(first) > firing_grid.head.tick_azimuth_rad(second);
    });
    return firings;
}

}  // namespace relidar::kitti
