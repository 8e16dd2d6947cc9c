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

/// Azimuth of each point, and 1 / its distance from the spin axis in metres.
struct PolarPoints {
    std::vector<double> azimuth_rad, inverse_rho;
};

/// Converts the points of all scans to polar coordinates, grouped by ring (beam). Leaves
/// out points nearer than 2 m.
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

/// Tests a lateral offset of a beam from the spin axis. Returns the mean of
///   exp(2 pi i (azimuth - lateral_offset_m / distance) / tick)
/// over every `point_stride`-th point. The absolute value is 1 if all corrected azimuths
/// have the same distance from the tick before them, and 0 if they are random. The
/// argument of the mean is this distance, where 2 pi is a full tick.
std::complex<double> mean_tick_phase(const PolarPoints& beam_points, double encoder_tick_rad,
                                     double lateral_offset_m, std::size_t point_stride) {
    std::complex<double> sum = 0.0;
    std::size_t n = 0;
    for (std::size_t i = 0; i < beam_points.azimuth_rad.size(); i += point_stride) {
        const double head_rad = beam_points.azimuth_rad[i] - lateral_offset_m * beam_points.inverse_rho[i];
        sum += std::polar(1.0, 2.0 * kPi * head_rad / encoder_tick_rad);
        ++n;
    }
    return n > 0 ? sum / double(n) : sum;
}

/// Model of a beam: azimuth = tick + phase_rad + left_m / distance from the spin axis.
/// `concentration` is the quality of the fit, 0 to 1.
struct TickGridPhase {
    double left_m = 0.0, phase_rad = 0.0, concentration = 0.0;
};

/// Improves the model azimuth = k * encoder_tick_rad + phase_rad + left_m / distance,
/// with integer k. Fits a line error = d_phase + d_left * u to the errors of the model by
/// least squares, where u = 1 / distance.
void refine_phase(TickGridPhase& phase, const PolarPoints& polar, double encoder_tick_rad) {
    double n = 0, sum_u = 0, sum_error = 0, sum_uu = 0, sum_u_error = 0;
    for (std::size_t i = 0; i < polar.azimuth_rad.size(); ++i) {
        const double u = polar.inverse_rho[i];
        const double error =
            std::remainder(polar.azimuth_rad[i] - phase.left_m * u - phase.phase_rad, encoder_tick_rad);
        // Points in the middle between two ticks are outliers.
        if (std::abs(error) > 0.25 * encoder_tick_rad) continue;
        n += 1;
        sum_u += u;
        sum_error += error;
        sum_uu += u * u;
        sum_u_error += u * error;
    }
    // With few points, or at similar distances, the lateral offset cannot be separated
    // from the azimuth offset. The standard deviation of u must be 0.01 / m.
    constexpr double kMinPoints = 16, kMinVariance = 1e-4;
    const double spread = n * sum_uu - sum_u * sum_u;  // n^2 times the variance of u
    if (n < kMinPoints || spread < kMinVariance * n * n) return;
    const double d_left = (n * sum_u_error - sum_u * sum_error) / spread;
    phase.left_m += d_left;
    phase.phase_rad += (sum_error - d_left * sum_u) / n;
}

/// Fits the left offset and the azimuth phase of one beam: searches the offset that fits
/// the encoder ticks best, in steps of 2 mm, and then refines it.
TickGridPhase fit_beam_phase(const PolarPoints& polar, double encoder_tick_rad) {
    // About 500 points are enough to compare the offsets.
    const std::size_t stride = std::max<std::size_t>(polar.azimuth_rad.size() / 500, 1);
    const auto fit_phase = [&](double left_m) {
        const std::complex<double> mean = mean_tick_phase(polar, encoder_tick_rad, left_m, stride);
        return TickGridPhase{left_m, std::arg(mean) * encoder_tick_rad / (2.0 * kPi), std::abs(mean)};
    };
    // The concentration is 1 if all azimuths have the same distance from a tick.
    TickGridPhase best{.concentration = -1.0};
    for (int mm = -60; mm <= 60; mm += 2) {
        const TickGridPhase phase = fit_phase(mm * 1e-3);
        if (phase.concentration > best.concentration) best = phase;
    }
    // Prefers offset 0 if it fits nearly as well.
    const TickGridPhase centred = fit_phase(0.0);
    if (centred.concentration > best.concentration - 0.02) best = centred;
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
        const std::size_t ring = std::size_t(k);
        phases.ring[ring] = fit_beam_phase(polar_rings[ring], encoder_tick_rad);
    });
    double n_points = 0;
    for (std::size_t k = 0; k < kRings; ++k) {
        const double n_ring_points = double(polar_rings[k].azimuth_rad.size());
        n_points += n_ring_points;
        phases.concentration += phases.ring[k].concentration * n_ring_points;
    }
    phases.concentration /= std::max(n_points, 1.0);
    return phases;
}

/// Estimates the firings per revolution: 2 pi divided by the mean azimuth step between
/// consecutive points of a beam. Ignores steps longer than 1.5 times the median, because
/// there are dropped rays in between.
int estimate_firings(const std::vector<const RingScan*>& scans) {
    constexpr double kMinStep_rad = 1e-5;  // points at the same or at a lower azimuth
    std::vector<double> steps_rad;
    for (const RingScan* scan : scans)
        for (std::size_t i = 1; i < scan->points.size(); ++i) {
            const glm::dvec4 a(scan->points[i - 1]), b(scan->points[i]);
            // angle from a to b about z: its sine and cosine, times both lengths
            const double step_rad = std::atan2(a.x * b.y - a.y * b.x, a.x * b.x + a.y * b.y);
            if (scan->ring[i] == scan->ring[i - 1] && step_rad > kMinStep_rad) steps_rad.push_back(step_rad);
        }
    if (steps_rad.empty()) return 1;
    const double longest_rad = 1.5 * compute_median(steps_rad);
    double sum_rad = 0.0, n = 0.0;
    for (const double step_rad : steps_rad)
        if (step_rad < longest_rad) {
            sum_rad += step_rad;
            n += 1.0;
        }
    return std::max(int(std::lround(2.0 * kPi * n / sum_rad)), 1);
}

/// [beams][points] Number of the encoder tick (a head angle at which a firing is
/// possible) at which each point was measured.
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

/// Returns [scans][ticks] at which ticks (head angles of the rotary encoder) the LiDAR
/// fired. All beams fire together, so at least `min_beams` beams have a return there.
/// @param tick_shift_of_each_beam  [beams] subtracted from the tick of each return of the
/// beam
std::vector<std::vector<char>> flag_fired_ticks(const std::vector<BeamTicks>& ticks_of_scans,
                                                const std::vector<int>& tick_shift_of_each_beam, int n_ticks,
                                                int min_beams) {
    std::vector<std::vector<char>> is_fired;
    for (const BeamTicks& scan : ticks_of_scans) {
        std::vector<int> n_returns(static_cast<std::size_t>(n_ticks));
        for (std::size_t k = 0; k < kRings; ++k)
            for (const int tick : scan[k]) {
                const int shifted = tick - tick_shift_of_each_beam[k];
                ++n_returns[std::size_t((shifted % n_ticks + n_ticks) % n_ticks)];
            }
        std::vector<char>& flags = is_fired.emplace_back(std::size_t(n_ticks));
        for (std::size_t t = 0; t < n_returns.size(); ++t) flags[t] = n_returns[t] >= min_beams;
    }
    return is_fired;
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
    const auto count_matches = [&](int shift) {
        std::size_t n = 0;
        for (std::size_t s = 0; s < ticks_of_scans.size(); ++s)
            for (const int tick : ticks_of_scans[s][ring])
                n += std::size_t(is_tick_fired[s][std::size_t(wrap_tick(tick - shift, n_ticks))]);
        return n;
    };
    const std::size_t matches_at_zero = count_matches(0);
    std::size_t most_matches = matches_at_zero;
    int best_shift = 0;
    // Tries -1, 1, -2, 2 and so on, so that the smallest of several equal offsets wins.
    for (int size = 1; size <= max_shift; ++size)
        for (const int shift : {-size, size})
            if (const std::size_t n = count_matches(shift); n > most_matches) {
                most_matches = n;
                best_shift = shift;
            }
    std::size_t n_returns = 0;
    for (const BeamTicks& scan : ticks_of_scans) n_returns += scan[ring].size();
    // Another offset must match at least 1 % more returns.
    return most_matches > matches_at_zero + n_returns / 100 ? best_shift : 0;
}

/// Returns the azimuth offset of each beam in encoder ticks. All beams fire together, so
/// correct offsets move the returns of a firing to the same tick.
std::vector<int> find_tick_shifts(const std::vector<BeamTicks>& ticks_of_scans, int n_ticks) {
    const int max_shift = std::min(int(kMaxOffset_rad / (2.0 * kPi) * n_ticks), n_ticks / 2 - 1);
    const std::size_t fullest_ring = std::size_t(
        std::ranges::max_element(ticks_of_scans[0], {}, std::ranges::size) - ticks_of_scans[0].begin());
    std::vector<BeamTicks> only_fullest(ticks_of_scans.size(), BeamTicks(kRings));
    for (std::size_t s = 0; s < only_fullest.size(); ++s)
        only_fullest[s][fullest_ring] = ticks_of_scans[s][fullest_ring];
    std::vector<int> shifts(kRings, 0);
    auto is_fired = flag_fired_ticks(only_fullest, shifts, n_ticks, 1);
    // Each pass shifts each beam in azimuth, so that its returns are at fired ticks. Pass
    // 1 uses the ticks of one beam, the beam with the most points, because the offsets
    // between beams are not known yet. Pass 2 uses the ticks at which at least kMinLasers
    // beams have returns after pass 1.
    for (int pass = 0; pass < 2; ++pass) {
        parallel_for(kRings, [&](int k) {
            shifts[std::size_t(k)] =
                find_tick_offset(ticks_of_scans, std::size_t(k), is_fired, n_ticks, max_shift);
        });
        is_fired = flag_fired_ticks(ticks_of_scans, shifts, n_ticks, kMinLasers);
    }
    return shifts;
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
    FiringGrid grid;
    grid.head.n_ticks = kEncoderTicks;
    RingPhases phases = fit_phases(polar, 2.0 * kPi / kEncoderTicks);
    // If the azimuths do not fit the encoder of a real HDL-64E, tries equal azimuth steps
    // instead.
    if (phases.concentration < kMinConcentration) {
        grid.head.n_ticks = estimate_firings(scans);
        grid.every_tick = true;
        phases = fit_phases(polar, 2.0 * kPi / grid.head.n_ticks);
    }
    if (phases.concentration < kMinConcentration) return grid;

    for (std::size_t k = 0; k < kRings; ++k) {
        grid.left_m[k] = phases.ring[k].left_m;
        grid.offset_rad[k] = phases.ring[k].phase_rad;
    }
    if (!grid.every_tick) {
        std::vector<BeamTicks> ticks;
        for (const RingScan* scan : scans) ticks.push_back(compute_ticks(*scan, grid));
        const std::vector<int> shift = find_tick_shifts(ticks, grid.head.n_ticks);
        for (std::size_t k = 0; k < kRings; ++k) grid.offset_rad[k] += shift[k] * grid.head.tick_step_rad();
    }
    // Shifts the offsets of all beams so that their mean is 0. The head then faces the
    // mean direction of the beams.
    const double mean_rad = std::accumulate(grid.offset_rad.begin(), grid.offset_rad.end(), 0.0) / kRings;
    for (double& offset_rad : grid.offset_rad) offset_rad -= mean_rad;
    grid.head.zero_rad += mean_rad;
    return grid;
}

std::vector<int> find_fired_ticks(const RingScan& scan, const FiringGrid& firing_grid) {
    // compute_ticks() has applied the beam offsets, so the shifts are 0.
    const std::vector<int> no_shifts(kRings, 0);
    const std::vector<char> is_fired = flag_fired_ticks({compute_ticks(scan, firing_grid)}, no_shifts,
                                                        firing_grid.head.n_ticks, kMinLasers)[0];
    std::vector<int> firings;
    for (int t = 0; t < firing_grid.head.n_ticks; ++t)
        if (firing_grid.every_tick || is_fired[std::size_t(t)]) firings.push_back(t);
    // The head turns clockwise, so azimuths decrease with time.
    std::sort(firings.begin(), firings.end(), [&](int first, int second) {
        return firing_grid.head.tick_azimuth_rad(first) > firing_grid.head.tick_azimuth_rad(second);
    });
    return firings;
}

}  // namespace relidar::kitti
