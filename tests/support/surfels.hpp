// SPDX-License-Identifier: Apache-2.0
// Converts between the arrays of the library (float, structure of arrays) and the surfels
// and records of the reference (double, array of structures). A test can thus pass the
// same numbers to a kernel and to the reference. Worlds of the reference renderer become
// scenes of the library, with a model per surfel range.
#pragma once

#include <vector>

#include <relidar/diff/traversal.hpp>
#include <relidar/scene/scene.hpp>

#include "../reference/render.hpp"

namespace relidar::test {

std::vector<reference::Surfel> to_reference(const Surfels& surfels);
Surfels to_surfels(const std::vector<reference::Surfel>& surfels);
std::vector<reference::Ray> to_reference(const WorldRays& rays);
WorldRays to_world_rays(const RayTable& table);

/// Returns the surfels with the indices `order`, without using the library.
Surfels take(const Surfels& surfels, const std::vector<std::uint32_t>& order);

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
