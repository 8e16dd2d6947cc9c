// SPDX-License-Identifier: Apache-2.0
// Runs one build of diff/traversal/collect_hits on a scene that is on the device already:
// what relidar::collect_hits does with a scene of its own, for tests that refit, rebuild
// or bring a tree themselves.
#pragma once

#include <relidar/diff/traversal.hpp>
#include "diff/traversal/collect_hits.hpp"

#include "diff/shared/trace.h"
#include "gpu/kernel.hpp"

namespace relidar::test {

/// @param scene  of trace_scene(); its rays, and where passes at the cap are counted, are
/// filled in
/// @param variant  of diff/traversal/collect_hits @param constants  of
/// traversal/trace_scene.hpp
CollectedHits collect(Device& device, const KernelVariant& variant, const std::vector<Constant>& constants,
                      shared::TraceScene scene, const WorldRays& rays, std::uint32_t max_hits);

}  // namespace relidar::test
