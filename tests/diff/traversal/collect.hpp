// SPDX-License-Identifier: Apache-2.0
// Runs a variant of the kernel diff/traversal/collect_hits on a scene that is already on
// the device. The public function relidar::collect_hits uploads the scene, so it cannot
// test trees that are refitted, rebuilt or supplied by the test.
#pragma once

#include <relidar/diff/traversal.hpp>
#include "diff/traversal/collect_hits.hpp"

#include "diff/shared/trace.h"
#include "gpu/kernel.hpp"

namespace relidar::test {

/// Collects the hits of rays.
/// @param scene from make_trace_scene_params(); this function fills in the rays and the
/// counter
/// @param variant variant of diff/traversal/collect_hits
/// @param constants constants of traversal/trace_scene.hpp
CollectedHits collect(Device& device, const KernelVariant& variant,
                      const std::vector<SpecialisationConstant>& constants, shared::TraceScene scene,
                      const WorldRays& rays, std::uint32_t max_hits);

}  // namespace relidar::test
