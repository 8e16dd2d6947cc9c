// SPDX-License-Identifier: Apache-2.0
// Fits the firing angles of an HDL-64E in two steps: first the left offset of each beam
// and its azimuth relative to the ticks of the encoder, then its offset in full ticks.
#include "read/datasets/kitti/firing_lattice.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <functional>
#include <numeric>

#include <relidar/base/math.hpp>
#include "base/median.hpp"
#include "base/parallel.hpp"
#include "log/sensor/beam_geometry.hpp"
#include "read/scans/robust_line.hpp"

namespace relidar::kitti {
namespace {

// maximum azimuth offset of a beam from the head; real HDL-64Es have at most 0.16 rad
constexpr double kMaxOffset_rad = 0.35;
// A firing has returns of at least this many beams. Fewer can be stray points.
constexpr int kMinBeamsPerFiring = 4;

struct PolarPoint {
    double azimuth_rad, inverse_rho;  ///< inverse_rho: 1 / distance from the spin axis in metres
};
using PolarRings = std::array<std::vector<PolarPoint>, kRings>;

/// Converts the points of all scans to polar coordinates, grouped by ring (beam). Leaves
/// out points nearer than 2 m.
PolarRings collect_polar(const std::vector<const RingScan*>& scans) {
    PolarRings polar;
    for (const RingScan* scan : scans)
        for (std::size_t i = 0; i < scan->points.size(); ++i) {
            const glm::dvec3 p(scan->points.position_m[i]);
            const double rho = std::hypot(p.x, p.y);
            // Files are rounded to a millimetre, so near points have inaccurate azimuths.
            if (rho >= 2.0) polar[scan->points.ring[i]].push_back({std::atan2(p.y, p.x), 1.0 / rho});
        }
    return polar;
}

/// Returns how well the azimuths of a beam fit to the ticks of the encoder, if the beam
/// starts `left_m` to the left of the spin axis. The head was then at
///   head = azimuth - left_m / rho.
/// The result is the mean of exp(2 pi i head / tick) over every `stride`-th point. Its
/// absolute value (the concentration) is 1 if all heads have the same distance from the
/// tick before them, and 0 if they are random. Its argument is this distance as an angle.
std::complex<double> mean_tick_phase(const std::vector<PolarPoint>& points, double tick_rad, double left_m,
                                     std::size_t stride) {
    std::complex<double> sum = 0.0;
    std::size_t n = 0;
    for (std::size_t i = 0; i < points.size(); i += stride) {
        const double head_rad = points[i].azimuth_rad - left_m * points[i].inverse_rho;
        sum += std::polar(1.0, 2.0 * kPi * head_rad / tick_rad);
        ++n;
    }
    return n > 0 ? sum / double(n) : sum;
}

/// Model of a beam that starts `left_m` to the left of the spin axis. At a distance rho
/// from the axis, azimuth = tick + phase_rad + left_m / rho. `concentration` is the
/// quality of the fit, 0 to 1.
struct TickGridPhase {
    double left_m = 0.0, phase_rad = 0.0, concentration = 0.0;
};

/// Improves the model of a beam that starts left_m to the left of the spin axis:
///   azimuth = k * tick_rad + phase_rad + left_m / rho,  with an integer k.
/// The differences between the points and this model are fitted by a line over 1 / rho.
/// Its slope is the correction of left_m, and its value at 0 that of phase_rad.
void refine_phase(TickGridPhase& model, const std::vector<PolarPoint>& points, double tick_rad) {
    std::vector<glm::dvec2> errors;  // 1 / rho, and the difference from the nearest tick
    for (const PolarPoint& p : points) {
        const double offset_rad = p.azimuth_rad - model.left_m * p.inverse_rho - model.phase_rad;
        errors.emplace_back(p.inverse_rho, std::remainder(offset_rad, tick_rad));
    }
    // Ignores points in the middle between two ticks. If the points are few or at similar
    // distances, both values cannot be separated. Then the line is 0 everywhere.
    constexpr double kMinDeviation = 0.01;  // standard deviation of 1 / rho
    const read::RobustLine correction = read::fit_line(
        errors, {}, 0.25 * tick_rad, {.min_points = 16, .min_variance = kMinDeviation * kMinDeviation});
    model.left_m += correction.slope;
    model.phase_rad += correction.at_zero;
}

/// Fits the model of one beam (see TickGridPhase): searches the left offset with the
/// highest concentration, which is 1 if all azimuths fit the ticks, and then refines it.
TickGridPhase fit_beam_phase(const std::vector<PolarPoint>& points, double tick_rad) {
    // Real HDL-64Es have offsets of up to 26 mm.
    constexpr int kMaxLeft_mm = 60, kStep_mm = 2;
    // The offset is 0 unless another one raises the concentration by this.
    constexpr double kMinGain = 0.02;
    // About 500 points are enough to compare the offsets.
    const std::size_t stride = std::max<std::size_t>(points.size() / 500, 1);
    const auto fit_phase = [&](double left_m) {
        const std::complex<double> mean = mean_tick_phase(points, tick_rad, left_m, stride);
        return TickGridPhase{left_m, std::arg(mean) * tick_rad / (2.0 * kPi), std::abs(mean)};
    };
    TickGridPhase best{.concentration = -1.0};
    for (int left_mm = -kMaxLeft_mm; left_mm <= kMaxLeft_mm; left_mm += kStep_mm) {
        const TickGridPhase phase = fit_phase(left_mm * 1e-3);
        if (phase.concentration > best.concentration) best = phase;
    }
    const TickGridPhase centred = fit_phase(0.0);
    if (centred.concentration > best.concentration - kMinGain) return centred;
    refine_phase(best, points, tick_rad);
    return best;
}

struct RingPhases {
    std::array<TickGridPhase, kRings> ring;
    double concentration = 0.0;  ///< mean over the points
};

/// Fits the model of every beam to an encoder with `n_ticks` per revolution. Its
/// concentration shows how well azimuths fit the ticks: 1 if exactly, 0 if at random.
/// That of the result is the mean over the beams, weighted by their numbers of points.
RingPhases fit_phases(const PolarRings& polar, int n_ticks) {
    RingPhases phases;
    const double tick_rad = 2.0 * kPi / n_ticks;
    parallel_for(kRings, [&](int k) {
        phases.ring[std::size_t(k)] = fit_beam_phase(polar[std::size_t(k)], tick_rad);
    });
    double n_points = 0;
    for (std::size_t k = 0; k < kRings; ++k) {
        const double n_ring_points = double(polar[k].size());
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
            const glm::dvec3 a(scan->points.position_m[i - 1]), b(scan->points.position_m[i]);
            // angle from a to b about z: its sine and cosine, times both lengths
            const double step_rad = std::atan2(a.x * b.y - a.y * b.x, a.x * b.x + a.y * b.y);
            if (scan->points.ring[i] == scan->points.ring[i - 1] && step_rad > kMinStep_rad)
                steps_rad.push_back(step_rad);
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

/// [beams][points] Encoder ticks, which are the angles at which the head can fire.
using BeamTicks = std::vector<std::vector<int>>;
/// [ticks] whether the LiDAR fired at a tick
using FiredTicks = std::vector<char>;

/// Returns for each point of a scan the tick nearest to the azimuth of the head at which
/// the beam of the point faced the point.
BeamTicks compute_ticks(const RingScan& scan, const FiringGrid& grid) {
    std::vector<BeamRays> beams;
    for (std::size_t k = 0; k < kRings; ++k)
        beams.emplace_back(Beam{.azimuth_offset_rad = grid.offset_rad[k], .origin_left_m = grid.left_m[k]});
    BeamTicks ticks(kRings);
    for (std::size_t i = 0; i < scan.points.size(); ++i) {
        const std::size_t k = scan.points.ring[i];
        const double head_rad = beams[k].azimuth_facing(glm::dvec3(scan.points.position_m[i]));
        ticks[k].push_back(grid.head.nearest_tick(head_rad));
    }
    return ticks;
}

/// Returns the ticks at which at least `min_returns` points were measured. All beams fire
/// together, so a firing has a return of many beams.
FiredTicks flag_fired_ticks(const BeamTicks& ticks, int n_ticks, int min_returns) {
    std::vector<int> n_returns(static_cast<std::size_t>(n_ticks));
    for (const std::vector<int>& beam : ticks)
        for (const int tick : beam) ++n_returns[std::size_t(tick)];
    FiredTicks is_fired;
    for (const int n : n_returns) is_fired.push_back(n >= min_returns);
    return is_fired;
}

/// Moves a tick that is at most one turn outside of [0, n_ticks) into this range.
int wrap_tick(int tick, int n_ticks) {
    if (tick < 0) return tick + n_ticks;
    return tick >= n_ticks ? tick - n_ticks : tick;
}

/// Returns the azimuth offset of a beam in ticks, to be subtracted from its ticks. With
/// the best offset, the most returns are at fired ticks. Returns 0 if no offset is
/// clearly better than 0.
/// @param ticks_of_scans, is_fired  [scans]
int find_tick_offset(const std::vector<BeamTicks>& ticks_of_scans, std::size_t beam,
                     const std::vector<FiredTicks>& is_fired) {
    const int n_ticks = int(is_fired[0].size());
    // less than half a turn, so that no offset is tried twice
    const int max_shift = std::min(int(kMaxOffset_rad / (2.0 * kPi) * n_ticks), n_ticks / 2 - 1);
    const auto count_matches = [&](int shift) {
        std::size_t n = 0;
        for (std::size_t s = 0; s < ticks_of_scans.size(); ++s)
            for (const int tick : ticks_of_scans[s][beam])
                n += std::size_t(is_fired[s][std::size_t(wrap_tick(tick - shift, n_ticks))]);
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
    for (const BeamTicks& scan : ticks_of_scans) n_returns += scan[beam].size();
    // Another offset must match at least 1 % more returns.
    return most_matches > matches_at_zero + n_returns / 100 ? best_shift : 0;
}

/// Returns find_tick_offset() of all beams.
std::vector<int> find_tick_offsets(const std::vector<BeamTicks>& ticks_of_scans,
                                   const std::vector<FiredTicks>& is_fired) {
    std::vector<int> offsets(kRings);
    parallel_for(kRings, [&](int k) {
        offsets[std::size_t(k)] = find_tick_offset(ticks_of_scans, std::size_t(k), is_fired);
    });
    return offsets;
}

/// Returns the azimuth offset of each beam in ticks of the encoder. All beams fire
/// together at some of the ticks, so correct offsets move the returns of a firing to the
/// same tick.
/// @param ticks_of_scans  [scans] tick nearest to each point, which contains the offset
std::vector<int> align_beams(const std::vector<BeamTicks>& ticks_of_scans, int n_ticks) {
    // First, the fired ticks are those of the beam with the most points, because the
    // offsets between beams are not known yet.
    const auto reference_beam =
        std::ranges::max_element(ticks_of_scans[0], {}, std::ranges::size) - ticks_of_scans[0].begin();
    std::vector<FiredTicks> is_fired;
    for (const BeamTicks& scan : ticks_of_scans)
        is_fired.push_back(flag_fired_ticks({scan[std::size_t(reference_beam)]}, n_ticks, 1));
    const std::vector<int> rough = find_tick_offsets(ticks_of_scans, is_fired);
    // With these offsets, a fired tick has returns of several beams.
    for (std::size_t s = 0; s < ticks_of_scans.size(); ++s) {
        BeamTicks moved = ticks_of_scans[s];
        for (std::size_t k = 0; k < kRings; ++k)
            for (int& tick : moved[k]) tick = wrap_tick(tick - rough[k], n_ticks);
        is_fired[s] = flag_fired_ticks(moved, n_ticks, kMinBeamsPerFiring);
    }
    return find_tick_offsets(ticks_of_scans, is_fired);
}

/// Adds a number of full ticks to the offset of each beam, because a fit to the encoder
/// gives an offset only up to a multiple of a tick.
void add_full_ticks(FiringGrid& grid, const std::vector<const RingScan*>& scans) {
    std::vector<BeamTicks> ticks;
    for (const RingScan* scan : scans) ticks.push_back(compute_ticks(*scan, grid));
    const std::vector<int> offsets = align_beams(ticks, grid.head.n_ticks);
    for (std::size_t k = 0; k < kRings; ++k) grid.offset_rad[k] += offsets[k] * grid.head.tick_step_rad();
}

}  // namespace

std::vector<Beam> FiringGrid::make_beams(const BeamCones& cones) const {
    std::vector<Beam> beams(kRings);
    for (std::size_t k = 0; k < kRings; ++k) {
        const double elevation = std::atan(cones[k].slope);
        beams[k] = {elevation, offset_rad[k], 0.0, cones[k].z0_m * std::cos(elevation), left_m[k]};
    }
    return beams;
}

FiringGrid fit_firing_grid(const std::vector<const RingScan*>& scans) {
    // Share of fit to the ticks (1: exact, 0: random) below which azimuths do not fit.
    constexpr double kMinConcentration = 0.8;
    const PolarRings polar = collect_polar(scans);
    FiringGrid grid;
    grid.head.n_ticks = kEncoderTicks;
    RingPhases phases = fit_phases(polar, kEncoderTicks);
    // If azimuths do not fit the encoder of a real HDL-64E, tries a tick for each firing.
    grid.every_tick = phases.concentration < kMinConcentration;
    if (grid.every_tick) {
        grid.head.n_ticks = estimate_firings(scans);
        phases = fit_phases(polar, grid.head.n_ticks);
        if (phases.concentration < kMinConcentration) return grid;
    }
    for (std::size_t k = 0; k < kRings; ++k) {
        grid.left_m[k] = phases.ring[k].left_m;
        grid.offset_rad[k] = phases.ring[k].phase_rad;
    }
    // If the head fires at every tick, full ticks make no difference.
    if (!grid.every_tick) add_full_ticks(grid, scans);
    // Makes the mean offset 0, so that the head faces the mean direction of the beams.
    const double mean_rad = std::accumulate(grid.offset_rad.begin(), grid.offset_rad.end(), 0.0) / kRings;
    for (double& offset_rad : grid.offset_rad) offset_rad -= mean_rad;
    grid.head.zero_rad += mean_rad;
    return grid;
}

std::vector<int> find_fired_ticks(const RingScan& scan, const FiringGrid& grid) {
    const FiredTicks is_fired =
        flag_fired_ticks(compute_ticks(scan, grid), grid.head.n_ticks, kMinBeamsPerFiring);
    std::vector<int> firings;
    for (int t = 0; t < grid.head.n_ticks; ++t)
        if (grid.every_tick || is_fired[std::size_t(t)]) firings.push_back(t);
    // The head turns clockwise, so azimuths decrease with time.
    std::ranges::sort(firings, std::greater{}, [&](int tick) { return grid.head.tick_azimuth_rad(tick); });
    return firings;
}

}  // namespace relidar::kitti
