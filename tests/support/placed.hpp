// SPDX-License-Identifier: Apache-2.0
// Between the oracle's worlds and the library's scenes: one model a range of surfels that
// some instance places.
#pragma once

#include <relidar/diff/traversal.hpp>

#include "surfels.hpp"

namespace relidar::test {

/// The scene and poses of a world, every distinct range of surfels a model. Models of a
/// scene lie one behind the other, so ranges that overlap become copies; a surfel that no
/// range holds is left out.
struct SceneAndPoses {
    Scene scene;
    std::vector<InstancePose> world_from_instance;
    /// [n] the world's number of each surfel of the scene, ascending within a model
    std::vector<std::uint32_t> original;
};
SceneAndPoses to_scene(const Surfels& surfels, const std::vector<reference::Placement>& placements);

WorldRays to_world_rays(const std::vector<reference::Ray>& rays);

/// What they measured; rays without a range are unknown ones, of another range, and
/// dropped ones in turn.
std::vector<shared::DeviceTarget> to_targets(const std::vector<reference::Ray>& rays);

}  // namespace relidar::test
