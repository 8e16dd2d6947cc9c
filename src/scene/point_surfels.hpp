// SPDX-License-Identifier: Apache-2.0
// Surfels from points: normals and scales from nearest neighbours (docs/method.md section
// 2). What the background and every actor share; private to scene.
#pragma once

#include <vector>

#include <relidar/scene/scene.hpp>

namespace relidar {

/// A point of the log: where, how bright, and from where it was seen. World, or the frame
/// of an actor's box.
struct Sample {
    glm::vec3 position;
    float intensity;
    glm::vec3 view;         ///< unit, sensor to point
    float walked_m = 0.0f;  ///< how far the actor had come (WalkedWay)
    int frame = 0;          ///< of an actor: position of its frame in the log
};

/// Calls work(WorldReturn) for the returns of a frame, ray by ray. @param second_returns
/// they too
template <class Work>
void for_each_return(const Sequence& sequence, const Frame& frame, bool second_returns, const Work& work) {
    const Scan& scan = frame.scan;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        if (!(scan.range_m[ray] > 0.0f)) continue;
        work(world_return(sequence, frame, ray));
        for (std::size_t k = 0; second_returns && k < scan.second_returns.size(); ++k)
            if (scan.second_returns[k].range_m[ray] > 0.0f) work(world_return(sequence, frame, ray, k + 1));
    }
}

/// One surfel a sample, in kd order. Where normals are found, intensity starts with the
/// fall with incidence of the log's surfaces.
/// @param samples at least one @param incidence of IntensityResponse @param order  [n]
/// output: the sample of each surfel
Surfels surfels_from_points(const std::vector<Sample>& samples, const InitialiseOptions& options,
                            double incidence, const Progress& progress = {},
                            std::vector<std::uint32_t>* order = nullptr);

/// First sample of each voxel of an actor, at most so many: averaging over jittering
/// labels would only shrink the box.
/// @param kept  output: their numbers
std::vector<Sample> thin_out(const std::vector<Sample>& samples, std::size_t most,
                             std::vector<std::uint32_t>* kept = nullptr);

}  // namespace relidar
