// SPDX-License-Identifier: Apache-2.0
// Converts worlds of the reference renderer to scenes of the library. Each range of
// surfels that an instance places becomes one model.
#pragma once

#include <relidar/diff/traversal.hpp>

#include "surfels.hpp"

namespace relidar::test {

/// Scene and poses of a reference world. Each distinct range of surfels is one model. The
/// models of a scene are stored one after another, so overlapping ranges are copied.
/// Surfels that belong to no range are left out.
struct SceneAndPoses {
    Scene scene;
    std::vector<InstancePose> world_from_instance;
    /// [n] Index in the reference world of each surfel of the scene, ascending within a
    /// model.
    std::vector<std::uint32_t> original;
};
SceneAndPoses to_scene(const Surfels& surfels, const std::vector<reference::Placement>& placements);

WorldRays to_world_rays(const std::vector<reference::Ray>& rays);

/// Returns the measurements of the rays. Rays without a range alternate between three
/// cases: unknown, of another range, and dropped.
std::vector<shared::DeviceTarget> to_targets(const std::vector<reference::Ray>& rays);

}  // namespace relidar::test
