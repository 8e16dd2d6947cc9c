// SPDX-License-Identifier: Apache-2.0
// Finds all hits of each ray, so that tests can check that all acceleration structures
// give the same hits.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/diff/traversal.hpp>

#include "diff/traversal/trace_scene.hpp"

namespace relidar {

struct CollectedHits {
    std::uint32_t max_hits = 0;
    std::vector<std::uint32_t> counts;    ///< [n_rays] number of hits, may exceed max_hits
    std::vector<float> t;                 ///< [n_rays, max_hits] distance of each hit in metres
    std::vector<std::uint32_t> instance;  ///< [n_rays, max_hits] instance of each hit
    std::vector<std::uint32_t> surfel;    ///< [n_rays, max_hits] surfel of each hit
};

/// Returns all hits of each ray, from near to far. Hits beyond `max_hits` per ray are
/// only counted.
/// @param scene from trace_params(); this function adds the rays
/// @param variant,constants of the kernel, see trace_scene.hpp
/// @throws DeviceError if a ray has too many hits to be traced completely
CollectedHits collect_hits(Device& device, const KernelVariant& variant, const TraceConstants& constants,
                           shared::TraceScene scene, const WorldRays& rays, std::uint32_t max_hits);

}  // namespace relidar
