// SPDX-License-Identifier: Apache-2.0
// Converts the worlds of the reference renderer to scenes of the library, with a model
// per surfel range.
#pragma once

#include <relidar/diff/traversal.hpp>

#include "surfels.hpp"

namespace relidar::test {

/// Scene and poses that correspond to a world. Each distinct range of surfels becomes a
/// model. The models of a scene are contiguous, so overlapping ranges become copies.
/// Surfels outside all ranges are omitted.
struct SceneAndPoses {
    Scene scene;
    std::vector<InstancePose> world_from_instance;
    /// [n] index of each surfel of the scene in the world. Indices are ascending within a
    /// model.
    std::vector<std::uint32_t> original;
};
SceneAndPoses to_scene(const Surfels& surfels, const std::vector<reference::Placement>& placements);
SceneAndPoses to_scene(const reference::World& world);

WorldRays to_world_rays(const std::vector<reference::Ray>& rays);

/// Converts rays to measured targets. Rays without a range become, in turn, unknown
/// targets, targets with a different range, and dropped targets.
std::vector<shared::DeviceTarget> to_targets(const std::vector<reference::Ray>& rays);

}  // namespace relidar::test
