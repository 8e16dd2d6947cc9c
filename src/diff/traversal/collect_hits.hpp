// SPDX-License-Identifier: Apache-2.0
// Finds all hits of each ray, so that tests can check that all acceleration structures
// give the same hits.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/diff/traversal.hpp>

#include "diff/traversal/trace_scene.hpp"

namespace relidar {

/// Returns the hits of each ray, from near to far, at most `max_hits` per ray.
/// @param scene from trace_params(); this function adds the rays
/// @param variant,constants of the kernel, see trace_scene.hpp
/// @throws DeviceError if a ray has too many hits to be traced completely
std::vector<std::vector<shared::Hit>> collect_hits(Device& device, const KernelVariant& variant,
                                                   const TraceConstants& constants, shared::TraceScene scene,
                                                   const WorldRays& rays, std::uint32_t max_hits);

}  // namespace relidar
