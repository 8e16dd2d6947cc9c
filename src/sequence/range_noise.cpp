// SPDX-License-Identifier: Apache-2.0
// Scatter of ranges about the planes of small cells, by range and incidence:
//   sigma = 1.4826 median |n . (p - q)| / |n . d|,   q, n the plane of the return's cell, d its direction.
#include <algorithm>
#include <array>
#include <cmath>
#include <unordered_map>

#include <relidar/sequence.hpp>

#include "core/cell_key.hpp"
#include "core/plane_sums.hpp"
#include "sequence/laser_returns.hpp"

namespace relidar {
namespace {

constexpr std::array kRanges_m = {10.0, 20.0, 30.0, 45.0, 80.0};
constexpr std::array kCosines = {0.3, 0.6, 1.0};
constexpr double kCell_m = 0.3, kLeastCosine = 0.1;
constexpr double kMinReturns = 20.0;          // of a cell that may be a plane
constexpr double kMaxThickness_m = 0.06, kMinExtent_m = 0.07;   // standard deviations across and along a plane
constexpr std::size_t kMostReturns = 3000000, kFewestOfBin = 200;
constexpr double kOfMedian = 1.4826;          // a normal deviate's standard deviation over its median absolute value

struct Seen {
    glm::dvec3 point_m;
    glm::vec3 direction;
    float range_m;
};

std::vector<Seen> returns_of(const Sequence& sequence, const Frame& frame) {
    std::vector<Seen> result;
    for (std::size_t ray = 0; ray < frame.scan.range_m.size(); ++ray) {
        if (!is_of_laser(sequence, frame.scan, ray, kRanges_m.back())) continue;
        const WorldReturn w = world_return(sequence, frame, ray);
        result.push_back({w.point_m, glm::vec3(w.direction), frame.scan.range_m[ray]});
    }
    return result;
}

/// A grid of cells, moved by a share of a cell.
struct Grid {
    double shift;
    std::uint64_t key(const glm::dvec3& p) const { return cell_key(p + shift * kCell_m, kCell_m); }
    glm::dvec3 centre(const glm::dvec3& p) const { return kCell_m * (glm::floor(p / kCell_m + shift) + 0.5 - shift); }
};

struct Surface {
    glm::dvec3 point_m, normal;
};
using Surfaces = std::unordered_map<std::uint64_t, Surface>;

/// Planes that pass through the middle half of their cells: a wall along the border of two would lend its scatter to both, cut in half.
Surfaces surfaces_of(const std::vector<std::vector<Seen>>& frames, const Grid& grid) {
    std::unordered_map<std::uint64_t, PlaneSums> cells;
    Surfaces surfaces;
    for (const std::vector<Seen>& frame : frames)
        for (const Seen& s : frame) {
            cells[grid.key(s.point_m)].add(s.point_m - grid.centre(s.point_m));
            surfaces[grid.key(s.point_m)].point_m = grid.centre(s.point_m);
        }
    for (const auto& [key, sums] : cells) {
        const PlaneFit fit = sums.fit();
        const bool is_plane = sums.n >= kMinReturns && fit.variance[0] < kMaxThickness_m * kMaxThickness_m && fit.variance[1] > std::max(kMinExtent_m * kMinExtent_m, fit.variance[0]);
        if (is_plane && std::abs(glm::dot(fit.axes[0], fit.mean)) < 0.25 * kCell_m) surfaces[key] = {surfaces[key].point_m + fit.mean, fit.axes[0]};
        else surfaces.erase(key);
    }
    return surfaces;
}

std::size_t bin(const auto& upper_ends, double value) {
    return std::min<std::size_t>(std::size_t(std::lower_bound(upper_ends.begin(), upper_ends.end(), value) - upper_ends.begin()), upper_ends.size() - 1);
}

double sigma_of(std::vector<float>& distances_m) {
    const auto middle = distances_m.begin() + std::ptrdiff_t(distances_m.size() / 2);
    std::nth_element(distances_m.begin(), middle, distances_m.end());
    return kOfMedian * double(*middle);
}

/// What no bin of its row or column has seen is as its neighbour: nearer first, then squarer.
void fill_gaps(RangeNoise& noise) {
    const std::size_t n_cosines = kCosines.size();
    for (std::size_t i = 0; i < noise.sigma_m.size(); ++i)
        if (noise.sigma_m[i] == 0.0 && i >= n_cosines) noise.sigma_m[i] = noise.sigma_m[i - n_cosines];
    for (std::size_t i = noise.sigma_m.size(); i-- > 0;)
        if (noise.sigma_m[i] == 0.0 && i + n_cosines < noise.sigma_m.size()) noise.sigma_m[i] = noise.sigma_m[i + n_cosines];
    for (std::size_t i = noise.sigma_m.size(); i-- > 0;)
        if (noise.sigma_m[i] == 0.0) noise.sigma_m[i] = *std::max_element(noise.sigma_m.begin(), noise.sigma_m.end());
}

}  // namespace

double RangeNoise::at(double at_m, double at_cosine) const {
    if (sigma_m.empty()) return 0.0;
    return sigma_m[bin(range_m, at_m) * cosine.size() + bin(cosine, at_cosine)];
}

std::size_t measure_range_noise(Sequence& sequence, const std::vector<int>& positions) {
    sequence.range_noise = {};
    const std::vector<std::vector<Seen>> frames = read_frames(sequence, positions, kMostReturns, [&](const Frame& frame) { return returns_of(sequence, frame); });
    std::vector<std::vector<float>> distances_m(kRanges_m.size() * kCosines.size());
    std::size_t n = 0;
    for (const double shift : {0.0, 0.5}) {
        const Grid grid{shift};
        const Surfaces surfaces = surfaces_of(frames, grid);
        for (const std::vector<Seen>& frame : frames)
            for (const Seen& s : frame) {
                const auto found = surfaces.find(grid.key(s.point_m));
                if (found == surfaces.end()) continue;
                const double facing = std::abs(glm::dot(found->second.normal, glm::dvec3(s.direction)));
                if (facing < kLeastCosine) continue;
                distances_m[bin(kRanges_m, double(s.range_m)) * kCosines.size() + bin(kCosines, facing)].push_back(
                    static_cast<float>(std::abs(glm::dot(found->second.normal, s.point_m - found->second.point_m)) / facing));
                ++n;
            }
    }
    if (n < kFewestOfBin) return 0;
    RangeNoise noise{{kRanges_m.begin(), kRanges_m.end()}, {kCosines.begin(), kCosines.end()}, std::vector<double>(distances_m.size(), 0.0)};
    for (std::size_t i = 0; i < distances_m.size(); ++i)
        if (distances_m[i].size() >= kFewestOfBin) noise.sigma_m[i] = sigma_of(distances_m[i]);
    fill_gaps(noise);
    sequence.range_noise = std::move(noise);
    return n;
}

}  // namespace relidar
