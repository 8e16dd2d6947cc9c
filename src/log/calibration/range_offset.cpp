// SPDX-License-Identifier: Apache-2.0
// Estimates the range offset of each beam of a log. The beams are compared on planes that
// several beams hit.
#include <cmath>
#include <optional>

#include <relidar/log/calibration.hpp>
#include <relidar/log/log.hpp>

#include "base/geometry/cell_key.hpp"
#include "base/geometry/cell_numbers.hpp"
#include "base/geometry/plane_sums.hpp"
#include "base/joined.hpp"
#include "log/calibration/beam_returns.hpp"

namespace relidar {
namespace {

// Edge length of the grid cells in which planes are fitted. In a smaller cell, noise
// would hide the plane. In a larger cell, a street would not be flat.
constexpr double kPlaneCell_m = 0.3;
// Farther cells contain too few returns for a plane.
constexpr double kMaxRange_m = 40.0;
constexpr std::size_t kMostOffsetReturns = 6000000;
constexpr std::size_t kMinReturns = 20;  // minimum number of returns in a cell for fitting a plane
// This limit applies twice. Points form a plane if their standard deviation is at most
// this along the normal, and at least this in both directions within the plane.
constexpr double kMaxThickness_m = 0.05;
constexpr double kMaxResidual_m = 0.15;
// A prior pulls the range offset of each beam to zero. It has the same weight as this
// number of returns at normal incidence.
constexpr double kPriorReturns = 20.0;
// The range offsets are used only if they reduce the RMS distance of points from planes
// to less than this ratio. Smaller improvements can be noise.
constexpr double kLeastGain = 0.97;
// Iterations of fitting planes and beam offsets. Few beams on a plane need many.
constexpr int kMaxRounds = 30;

/// A return in the world frame, not yet corrected by the range offset of its beam.
struct RawReturn {
    glm::vec3 point_m;  ///< relative to the world's origin, which is in the middle of the log
    glm::vec3 direction;
    std::uint32_t beam;
};

std::vector<RawReturn> world_returns(const Log& log, const Frame& frame) {
    std::vector<RawReturn> result;
    visit_returns(log, frame, kMaxRange_m, [&](std::size_t, std::uint16_t beam, const WorldReturn& w) {
        result.push_back({glm::vec3(w.point_m), glm::vec3(w.direction), beam});
    });
    return result;
}

/// Returns the returns in each grid cell. Cells with fewer than kMinReturns are empty,
/// because so few returns determine no plane. Range offsets do not change the cell of a
/// return, because they are very small.
std::vector<std::vector<RawReturn>> group_by_cell(const Log& log, const std::vector<int>& frames) {
    const std::vector<RawReturn> all = concatenate(map_frames(
        log, frames, kMostOffsetReturns, [&](const Frame& frame) { return world_returns(log, frame); }));
    const CellItemLists indices_by_cell(number_cells(all.size(), [&](std::size_t index) {
        return grid_key(glm::dvec3(all[index].point_m), kPlaneCell_m);
    }));
    std::vector<std::vector<RawReturn>> cells(indices_by_cell.size());
    parallel_blocks(cells.size(), [&](std::size_t cell) {
        const std::span<const std::uint32_t> return_indices = indices_by_cell.items_of(cell);
        if (return_indices.size() < kMinReturns) return;
        for (const std::uint32_t i : return_indices) cells[cell].push_back(all[i]);
    });
    return cells;
}

glm::dvec3 corrected_point(const RawReturn& uncorrected_return, const std::vector<double>& beam_offsets_m) {
    return glm::dvec3(uncorrected_return.point_m) -
           beam_offsets_m[uncorrected_return.beam] * glm::dvec3(uncorrected_return.direction);
}

struct CellPlane {
    glm::dvec3 point, normal;
};

/// Fits a plane to the corrected returns of a cell. Returns nothing if the points are too
/// thick or too narrow.
std::optional<CellPlane> fit_cell_plane(const std::vector<RawReturn>& cell_returns,
                                        const std::vector<double>& beam_offsets_m) {
    constexpr double kMaxVariance_m2 = kMaxThickness_m * kMaxThickness_m;
    // Coordinates relative to a point of the cell keep the precision of their squares.
    const glm::dvec3 reference_m = corrected_point(cell_returns[0], beam_offsets_m);
    PointMomentSums sums;
    for (const RawReturn& r : cell_returns) sums.add_point(corrected_point(r, beam_offsets_m) - reference_m);
    // Axis 0 has the least variance. It is the normal of the plane.
    const PlaneFit fit = sums.fit_plane();
    if (fit.variance[0] > kMaxVariance_m2 || fit.variance[1] < kMaxVariance_m2) return std::nullopt;
    return CellPlane{reference_m + fit.mean, fit.axes[0]};
}

/// Sums over the returns of a beam. c: cosine of incidence. d: distance of the
/// uncorrected return from its plane. A range offset o moves a return by o * c along the
/// normal of the plane, so the least-squares solution of o * c = d is o = sum / weight.
struct BeamOffsetSums {
    double weight = 0.0;  ///< sum of c * c
    double sum = 0.0;     ///< sum of c * d
};

/// Sums over the returns of some cells.
struct BeamResiduals {
    std::vector<BeamOffsetSums> fits;  ///< [beams]
    std::size_t n = 0;                 ///< number of returns
    double squares = 0.0;              ///< of the distances of corrected returns from their planes

    /// Adds the returns of a cell, if they form a plane.
    void add_cell(const std::vector<RawReturn>& cell_returns, const std::vector<double>& beam_offsets_m) {
        if (cell_returns.empty()) return;
        const std::optional<CellPlane> plane = fit_cell_plane(cell_returns, beam_offsets_m);
        if (!plane) return;
        for (const RawReturn& r : cell_returns) {
            const double cosine = glm::dot(plane->normal, glm::dvec3(r.direction));
            const double residual_m =
                glm::dot(plane->normal, corrected_point(r, beam_offsets_m) - plane->point);
            if (cosine == 0.0 || std::abs(residual_m) > kMaxResidual_m) continue;
            const double uncorrected_m = residual_m + beam_offsets_m[r.beam] * cosine;
            ++n;
            squares += residual_m * residual_m;
            fits[r.beam].weight += cosine * cosine;
            fits[r.beam].sum += cosine * uncorrected_m;
        }
    }
    BeamResiduals& operator+=(const BeamResiduals& other) {
        n += other.n;
        squares += other.squares;
        for (std::size_t b = 0; b < fits.size(); ++b) {
            fits[b].weight += other.fits[b].weight;
            fits[b].sum += other.fits[b].sum;
        }
        return *this;
    }
};

/// Sums the returns of all cells, in parallel but in a fixed order. The sums of each beam
/// also contain a prior: kPriorReturns returns with c = 1 and d = 0 (BeamOffsetSums).
BeamResiduals sum_residuals(const std::vector<std::vector<RawReturn>>& cells,
                            const std::vector<double>& beam_offsets_m) {
    constexpr std::size_t kCellsPerBlock = 2048;
    BeamResiduals all{
        .fits = std::vector<BeamOffsetSums>(beam_offsets_m.size(), {.weight = kPriorReturns, .sum = 0.0})};
    all += parallel_sum(cells.size(), kCellsPerBlock, [&](std::size_t begin, std::size_t end) {
        BeamResiduals block{.fits = std::vector<BeamOffsetSums>(beam_offsets_m.size())};
        for (std::size_t cell = begin; cell < end; ++cell) block.add_cell(cells[cell], beam_offsets_m);
        return block;
    });
    return all;
}

}  // namespace

RangeCalibrationResult calibrate_ranges(Log& log, const std::vector<int>& frame_indices) {
    const std::vector<Beam*> beams = list_beams(log);
    for (Beam* beam : beams) beam->range_offset_m = 0.0;
    const std::vector<std::vector<RawReturn>> cells = group_by_cell(log, frame_indices);
    RangeCalibrationResult result;
    if (cells.empty()) return result;
    std::vector<double> offset_m(beams.size(), 0.0);
    // Alternates: fits planes with the current offsets, then offsets to the planes.
    for (int round = 0; round < kMaxRounds; ++round) {
        const BeamResiduals residuals = sum_residuals(cells, offset_m);
        double weighted_sum_m = 0.0, weight_sum = 0.0;
        for (std::size_t b = 0; b < offset_m.size(); ++b) {
            const auto& [weight, sum] = residuals.fits[b];
            offset_m[b] = sum / weight;
            weighted_sum_m += weight * offset_m[b];
            weight_sum += weight;
        }
        // An offset of all beams moves planes and points together, so it cannot be
        // measured. The mean becomes 0.
        for (double& offset : offset_m) offset -= weighted_sum_m / weight_sum;
        result.returns = residuals.n;
        result.rms_after = std::sqrt(residuals.n > 0 ? residuals.squares / double(residuals.n) : 0.0);
        // The residuals belong to the offsets before this round, at first 0.
        if (round == 0) result.rms_before = result.rms_after;
    }
    if (result.rms_after > kLeastGain * result.rms_before) return result;
    result.adopted = true;
    for (std::size_t b = 0; b < offset_m.size(); ++b) beams[b]->range_offset_m = offset_m[b];
    return result;
}

}  // namespace relidar
