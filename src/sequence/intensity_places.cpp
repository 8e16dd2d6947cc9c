// SPDX-License-Identifier: Apache-2.0
#include "sequence/intensity_places.hpp"

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "core/cell_key.hpp"
#include "core/plane_sums.hpp"
#include "sequence/beam_returns.hpp"

namespace relidar {
namespace {

constexpr double kPlace_m = 0.1;            // small enough to be one surface, large enough to be hit again
constexpr double kSurface_m = 0.4;          // cells whose planes say how the place lies
constexpr double kMinPoints = 8.0;
constexpr double kMaxThickness = 0.15;      // of a surface over its narrower extent, standard deviations
constexpr std::size_t kMostReturns = 6000000;

struct Seen {
    glm::dvec3 point_m;
    glm::vec3 direction;
    PlaceReturn given;   ///< place and cosine are still to be found
};

std::vector<Seen> returns_of(const Sequence& sequence, const Frame& frame) {
    std::vector<Seen> result;
    const Scan& scan = frame.scan;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        const auto beam = beam_that_saw(sequence, frame, ray, sequence.lidar_of(frame).sensor.max_range_m);
        if (!beam) continue;
        const WorldReturn w = world_return(sequence, frame, ray);
        result.push_back(
            {w.point_m, glm::vec3(w.direction), {0, *beam, surface_return(sequence, frame, ray).range_m, 0.0f, scan.intensity[ray]}});
    }
    return result;
}

using Surfaces = std::unordered_map<std::uint64_t, glm::vec3>;   // normals by cell

Surfaces surfaces_of(const std::vector<std::vector<Seen>>& frames) {
    std::unordered_map<std::uint64_t, PlaneSums> cells;
    for (const std::vector<Seen>& frame : frames)
        for (const Seen& s : frame) cells[cell_key(s.point_m, kSurface_m)].add(s.point_m - kSurface_m * glm::floor(s.point_m / kSurface_m));
    Surfaces surfaces;
    for (const auto& [key, sums] : cells) {
        if (sums.n < kMinPoints) continue;
        const PlaneFit fit = sums.fit();
        if (fit.variance[0] <= kMaxThickness * kMaxThickness * fit.variance[1]) surfaces.emplace(key, glm::vec3(fit.axes[0]));
    }
    return surfaces;
}

}  // namespace

PlaceReturns returns_of_places(const Sequence& sequence, const std::vector<int>& positions) {
    std::vector<std::vector<Seen>> frames =
        read_frames(sequence, positions, kMostReturns, [&](const Frame& frame) { return returns_of(sequence, frame); });
    const Surfaces surfaces = surfaces_of(frames);
    std::unordered_map<std::uint64_t, std::uint32_t> number;
    std::vector<std::uint32_t> count;
    std::vector<PlaceReturn> all;
    for (std::vector<Seen>& frame : frames) {
        for (Seen& s : frame) {
            const auto surface = surfaces.find(cell_key(s.point_m, kSurface_m));
            if (surface == surfaces.end()) continue;
            s.given.place = number.try_emplace(cell_key(s.point_m, kPlace_m), static_cast<std::uint32_t>(count.size())).first->second;
            s.given.cosine = std::abs(glm::dot(surface->second, s.direction));
            if (s.given.place == count.size()) count.push_back(0);
            ++count[s.given.place];
            all.push_back(s.given);
        }
        frame = {};
    }
    std::vector<std::size_t> next(count.size() + 1, 0);   // where each place's returns go, those that nobody shares left out
    for (std::size_t place = 0; place < count.size(); ++place) next[place + 1] = next[place] + (count[place] < 2 ? 0 : count[place]);
    std::vector<PlaceReturn> by_place(next.back());
    for (const PlaceReturn& r : all)
        if (count[r.place] >= 2) by_place[next[r.place]++] = r;
    return {std::move(by_place), count.size()};
}

}  // namespace relidar
