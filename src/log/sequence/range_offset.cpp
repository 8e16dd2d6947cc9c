// SPDX-License-Identifier: Apache-2.0
// Estimates the range offset of each beam of a log. The beams are compared on planes that
// several beams hit.
#include <algorithm>
#include <cmath>
#include <optional>
#include <span>

#include <relidar/log/sequence.hpp>

#include "base/cell_key.hpp"
#include "base/cell_numbers.hpp"
#include "base/joined.hpp"
#include "base/plane_sums.hpp"
#include "log/sequence/beam_returns.hpp"

namespace relidar {
namespace {

// Size of the cells in which planes are fitted: large enough to distinguish a plane from
// noise, and small enough that streets are flat.
constexpr double kCell_m = 0.3;
// Farther returns are ignored, because cells at this distance contain too few returns.
constexpr double kMaxRange_m = 40.0;
constexpr std::size_t kMostOffsetReturns = 6000000;
constexpr int kMinReturns = 20;  // minimum number of returns in a cell for fitting a plane
// Points form a plane if their standard deviation is below this value across the plane,
// and above it along the plane.
constexpr double kMaxThickness_m = 0.05;
// Points farther from the plane of their cell belong to another object and are ignored.
constexpr double kMaxResidual_m = 0.15;
// Weight of the prior that pulls range offsets to zero, as a number of returns at normal
// incidence.
constexpr double kPriorReturns = 20.0;
// Range offsets are used only if they reduce the residuals to less than this ratio.
// Otherwise they are only noise.
constexpr double kLeastGain = 0.97;
// Number of iterations. Offsets converge slowly if few beams observe the same plane.
constexpr int kRounds = 30;

/// A return in the world frame, not yet corrected by the range offset of its beam.
struct Observation {
    glm::vec3 point_m;  ///< relative to the world's origin, which is in the middle of the log
    glm::vec3 direction;
    std::uint32_t beam;
};

std::vector<Observation> collect_observations(const Sequence& sequence, const Frame& frame) {
    std::vector<Observation> result;
    for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
        const auto beam = find_beam_of_return(sequence, frame, ray, kMaxRange_m);
        if (!beam) continue;
        const WorldReturn w = compute_world_return(sequence, frame, ray);
        result.push_back({glm::vec3(w.point_m), glm::vec3(w.direction), *beam});
    }
    return result;
}

/// Returns of a log, sorted by cell and, within a cell, by frame. Range offsets move
/// returns by centimetres, but do not change their cells.
struct Cells {
    std::vector<Observation> seen;
    std::vector<std::size_t> first;  ///< [cells + 1] index into `seen`

    std::size_t size() const { return first.size() - 1; }
    std::span<const Observation> of(std::size_t cell) const {
        return std::span(seen).subspan(first[cell], first[cell + 1] - first[cell]);
    }
};

Cells collect_observation_cells(const Sequence& sequence, const std::vector<int>& positions) {
    const std::vector<Observation> all =
        concatenate(read_frames(sequence, positions, kMostOffsetReturns,
                                [&](const Frame& frame) { return collect_observations(sequence, frame); }));
    const ItemsOfCells items(assign_cell_numbers(all.size(), [&](std::size_t index) {
        return make_cell_key(glm::dvec3(all[index].point_m), kCell_m);
    }));
    Cells cells{std::vector<Observation>(all.size()), {0}};
    for (std::size_t cell = 0; cell < items.size(); ++cell)
        cells.first.push_back(cells.first.back() + items.of(cell).size());
    for_each_block(items.size(), [&](std::size_t cell) {
        for (std::size_t k = 0; k < items.of(cell).size(); ++k)
            cells.seen[cells.first[cell] + k] = all[items.of(cell)[k]];
    });
    return cells;
}

glm::dvec3 shift_by_range_offset(const Observation& observation, const std::vector<double>& offset_m) {
    return glm::dvec3(observation.point_m) - offset_m[observation.beam] * glm::dvec3(observation.direction);
}

/// Plane of a cell.
struct Plane {
    glm::dvec3 point;
    glm::dvec3 normal;
};

std::optional<Plane> fit_plane_of_cell(std::span<const Observation> observations,
                                       const std::vector<double>& offset_m) {
    if (observations.size() < std::size_t(kMinReturns)) return std::nullopt;
    const glm::dvec3 about = shift_by_range_offset(observations[0], offset_m);
    PlaneSums sums;
    for (const Observation& o : observations) sums.add(shift_by_range_offset(o, offset_m) - about);
    const PlaneFit fit = sums.fit();
    if (fit.variance[0] > kMaxThickness_m * kMaxThickness_m ||
        fit.variance[1] < kMaxThickness_m * kMaxThickness_m)
        return std::nullopt;
    return Plane{about + fit.mean, fit.axes[0]};
}

/// Sums over the returns of one beam. `weight`: squared cosines of incidence. `sum`:
/// distances from planes, multiplied by these cosines.
struct OffsetFit {
    double weight = 0.0;
    double sum = 0.0;
};

/// Sums of the residuals in some cells, by beam.
struct Residuals {
    std::vector<OffsetFit> fits;  ///< [beams]
    std::size_t n = 0;
    double squares = 0.0;

    void add(const Observation& observation, const Plane& plane, const std::vector<double>& offset_m) {
        const double facing = glm::dot(plane.normal, glm::dvec3(observation.direction)),
                     residual =
                         glm::dot(plane.normal, shift_by_range_offset(observation, offset_m) - plane.point);
        if (facing == 0.0 || std::abs(residual) > kMaxResidual_m) return;
        ++n;
        squares += residual * residual;
        fits[observation.beam].weight += facing * facing;
        // Adds the full offset instead of its change, so that the prior pulls the full
        // offset to zero.
        fits[observation.beam].sum += facing * (residual + offset_m[observation.beam] * facing);
    }
    Residuals& operator+=(const Residuals& other) {
        n += other.n;
        squares += other.squares;
        for (std::size_t b = 0; b < fits.size(); ++b) {
            fits[b].weight += other.fits[b].weight;
            fits[b].sum += other.fits[b].sum;
        }
        return *this;
    }
};

/// Computes the distances of all returns from the planes of their cells with the current
/// offsets. Blocks of cells run in parallel, but sums are added in a fixed order.
Residuals compute_residuals(const Cells& cells, const std::vector<double>& offset_m) {
    constexpr std::size_t kBlock = 2048;
    Residuals all{.fits = std::vector<OffsetFit>(offset_m.size(), {.weight = kPriorReturns, .sum = 0.0})};
    all += parallel_reduce(cells.size(), kBlock, [&](std::size_t begin, std::size_t end) {
        Residuals block{.fits = std::vector<OffsetFit>(offset_m.size())};
        for (std::size_t cell = begin; cell < end; ++cell) {
            const std::span<const Observation> seen = cells.of(cell);
            const std::optional<Plane> plane = fit_plane_of_cell(seen, offset_m);
            if (!plane) continue;
            for (const Observation& o : seen) block.add(o, *plane, offset_m);
        }
        return block;
    });
    return all;
}

/// Updates the range offsets of all beams once.
/// @return number and mean square of the residuals before the update
std::pair<std::size_t, double> fit_offsets(const Cells& cells, std::vector<double>& offset_m) {
    const Residuals r = compute_residuals(cells, offset_m);
    double mean = 0.0, weight = 0.0;
    for (std::size_t b = 0; b < offset_m.size(); ++b) {
        offset_m[b] = r.fits[b].sum / r.fits[b].weight;
        mean += r.fits[b].weight * offset_m[b];
        weight += r.fits[b].weight;
    }
    // An offset that all ranges have in common cannot be distinguished from a different
    // scene, so the mean offset is removed.
    for (double& offset : offset_m) offset -= mean / weight;
    return {r.n, r.n > 0 ? r.squares / double(r.n) : 0.0};
}

}  // namespace

LaserCalibration calibrate_ranges(Sequence& sequence, const std::vector<int>& positions) {
    const std::vector<Beam*> beams = list_beams(sequence);
    for (Beam* beam : beams) beam->range_offset_m = 0.0;
    const Cells cells = collect_observation_cells(sequence, positions);
    LaserCalibration result;
    if (cells.seen.empty()) return result;
    std::vector<double> offset_m(beams.size(), 0.0);
    for (int round = 0; round < kRounds; ++round) {
        const auto [n, mean_square] = fit_offsets(cells, offset_m);
        result.returns = n;
        result.rms_after = std::sqrt(mean_square);
        if (round == 0) result.rms_before = result.rms_after;
    }
    if (result.rms_after > kLeastGain * result.rms_before) return result;
    result.adopted = true;
    for (std::size_t b = 0; b < offset_m.size(); ++b) beams[b]->range_offset_m = offset_m[b];
    return result;
}

}  // namespace relidar
