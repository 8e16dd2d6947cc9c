// SPDX-License-Identifier: Apache-2.0
// Range offsets of the beams of a log: what each adds to every range, from planes that several beams have seen.
#include <algorithm>
#include <cmath>
#include <unordered_map>

#include <relidar/sequence.hpp>

#include "core/cell_key.hpp"
#include "core/parallel.hpp"
#include "core/plane_sums.hpp"
#include "sequence/beam_returns.hpp"

namespace relidar {
namespace {

constexpr double kCell_m = 0.3;             // large enough for a plane to be told from noise, small enough for a street to be flat in
constexpr double kMaxRange_m = 40.0;        // farther out a cell has too few returns
constexpr std::size_t kMostOffsetReturns = 6000000;
constexpr int kMinReturns = 20;             // of a cell that may be a plane
constexpr double kMaxThickness_m = 0.05;    // standard deviation across a plane, and at least along it
constexpr double kMaxResidual_m = 0.15;     // what lies farther off its cell's plane belongs to something else
constexpr double kPriorReturns = 20.0;      // a beam starts as if so many of its returns, met squarely, had shown no offset
constexpr double kLeastGain = 0.97;         // beams whose planes do not get this much thinner have no offsets: what was found is noise
constexpr int kRounds = 30;                // planes that few beams share follow them only slowly

/// One return in the world, by its beam's own word.
struct Observation {
    glm::vec3 point_m;       ///< from the world's origin, which is in the middle of the log
    glm::vec3 direction;
    std::uint32_t cell;
    std::uint32_t beam;
};

std::vector<Observation> observations_of(const Sequence& sequence, const Frame& frame) {
    std::vector<Observation> result;
    for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
        const auto beam = beam_that_saw(sequence, frame, ray, kMaxRange_m);
        if (!beam) continue;
        const WorldReturn w = world_return(sequence, frame, ray);
        result.push_back({glm::vec3(w.point_m), glm::vec3(w.direction), 0, *beam});
    }
    return result;
}

/// Returns of the frames, and how many cells they fall into. A cell keeps its returns while they move by centimetres.
std::vector<Observation> gather(const Sequence& sequence, const std::vector<int>& positions, std::size_t& n_cells) {
    std::vector<std::vector<Observation>> frames =
        read_frames(sequence, positions, kMostOffsetReturns, [&](const Frame& frame) { return observations_of(sequence, frame); });
    std::unordered_map<std::uint64_t, std::uint32_t> number;
    std::vector<Observation> all;
    for (std::vector<Observation>& frame : frames) {
        for (Observation& o : frame)
            o.cell = number.try_emplace(cell_key(glm::dvec3(o.point_m), kCell_m), static_cast<std::uint32_t>(number.size())).first->second;
        all.insert(all.end(), frame.begin(), frame.end());
        frame = {};
    }
    n_cells = number.size();
    return all;
}

glm::dvec3 moved(const Observation& o, const std::vector<double>& offset_m) {
    return glm::dvec3(o.point_m) - offset_m[o.beam] * glm::dvec3(o.direction);
}

/// A cell's plane.
struct Plane {
    glm::dvec3 point{0.0};
    glm::dvec3 normal{0.0};   ///< zero where the cell is no plane
};

std::vector<Plane> planes_of(const std::vector<Observation>& seen, const std::vector<double>& offset_m, std::size_t n_cells) {
    struct CellSums {
        PlaneSums sums;          // from the cell's first point
        glm::dvec3 about{0.0};
    };
    std::vector<CellSums> cells(n_cells);
    for (const Observation& o : seen) {
        CellSums& s = cells[o.cell];
        const glm::dvec3 at = moved(o, offset_m);
        if (s.sums.n == 0.0) s.about = at;
        s.sums.add(at - s.about);
    }
    std::vector<Plane> planes(n_cells);
    for_each_block(n_cells, [&](std::size_t i) {
        if (cells[i].sums.n < kMinReturns) return;
        const PlaneFit fit = cells[i].sums.fit();
        if (fit.variance[0] > kMaxThickness_m * kMaxThickness_m || fit.variance[1] < kMaxThickness_m * kMaxThickness_m) return;
        planes[i] = {cells[i].about + fit.mean, fit.axes[0]};
    });
    return planes;
}

/// Sums of one beam's returns: residuals across their planes, by how squarely they were met.
struct OffsetFit {
    double weight = kPriorReturns;
    double sum = 0.0;
};

/// One step of every beam's offset towards the planes. @return count and mean square of the residuals that come in
std::pair<std::size_t, double> fit_offsets(const std::vector<Observation>& seen, const std::vector<Plane>& planes,
                                           std::vector<double>& offset_m) {
    std::vector<OffsetFit> fits(offset_m.size());
    std::size_t n = 0;
    double squares = 0.0;
    for (const Observation& o : seen) {
        const Plane& plane = planes[o.cell];
        const double facing = glm::dot(plane.normal, glm::dvec3(o.direction)),
                     residual = glm::dot(plane.normal, moved(o, offset_m) - plane.point);
        if (facing == 0.0 || std::abs(residual) > kMaxResidual_m) continue;
        ++n;
        squares += residual * residual;
        fits[o.beam].weight += facing * facing;
        // of the whole offset, so that the prior holds it, not the step
        fits[o.beam].sum += facing * (residual + offset_m[o.beam] * facing);
    }
    double mean = 0.0, weight = 0.0;
    for (std::size_t b = 0; b < fits.size(); ++b) {
        offset_m[b] = fits[b].sum / fits[b].weight;
        mean += fits[b].weight * offset_m[b];
        weight += fits[b].weight;
    }
    for (double& offset : offset_m) offset -= mean / weight;   // all ranges longer by the same: hardly to be told from another scene
    return {n, n > 0 ? squares / double(n) : 0.0};
}

}  // namespace

LaserCalibration calibrate_ranges(Sequence& sequence, const std::vector<int>& positions) {
    const std::vector<Beam*> beams = beams_of(sequence);
    for (Beam* beam : beams) beam->range_offset_m = 0.0;
    std::size_t n_cells = 0;
    const std::vector<Observation> seen = gather(sequence, positions, n_cells);
    LaserCalibration result;
    if (seen.empty()) return result;
    std::vector<double> offset_m(beams.size(), 0.0);
    for (int round = 0; round < kRounds; ++round) {
        const auto [n, mean_square] = fit_offsets(seen, planes_of(seen, offset_m, n_cells), offset_m);
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
