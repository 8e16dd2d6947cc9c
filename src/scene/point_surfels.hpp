// SPDX-License-Identifier: Apache-2.0
// Surfels from points: normals and scales from nearest neighbours (docs/method.md section 2). What the background and every actor
// share; private to scene.
#pragma once

#include <vector>

#include <relidar/scene.hpp>

#include "core/parallel.hpp"

namespace relidar {

/// A point of the log: where, how bright, and from where it was seen. World, or the frame of an actor's box.
struct Sample {
    glm::vec3 position;
    float intensity;
    glm::vec3 view;   ///< unit, sensor to point
};

/// task(i) for every i < n, on all cores in blocks.
template <class Task>
void for_each_block(std::size_t n, const Task& task) {
    constexpr std::size_t kBlock = 4096;
    run_parallel(static_cast<int>((n + kBlock - 1) / kBlock), [&](int block) {
        const std::size_t end = std::min(n, (std::size_t(block) + 1) * kBlock);
        for (std::size_t i = std::size_t(block) * kBlock; i < end; ++i) task(i);
    });
}

/// One surfel a sample, in kd order. @param samples at least one
Surfels surfels_from_points(const std::vector<Sample>& samples, const InitialiseOptions& options);

}  // namespace relidar
