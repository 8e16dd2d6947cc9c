// SPDX-License-Identifier: Apache-2.0
// Finds all hits of each ray, so that tests can check that all acceleration structures
// give the same hits.
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/diff/accel.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/scene/device_scene.hpp>

namespace relidar {

struct CollectedHits {
    std::uint32_t max_hits = 0;
    std::vector<std::uint32_t> counts;    ///< [n_rays] number of hits, may exceed max_hits
    std::vector<float> t;                 ///< [n_rays, max_hits] distance of each hit in metres
    std::vector<std::uint32_t> instance;  ///< [n_rays, max_hits] instance of each hit
    std::vector<std::uint32_t> surfel;    ///< [n_rays, max_hits] surfel of each hit
};

struct PosedScene {
    const Scene* scene = nullptr;
    std::vector<InstancePose> world_from_instance;
    ImageFormationModel model;
    AccelOptions accel;
    TraceOptions trace;
};

/// Returns all hits of each ray, from near to far.
/// @param max_hits_per_ray maximum number of stored hits per ray. Further hits are only
/// counted
/// @throws DeviceError if a ray has too many hits to be traced completely
CollectedHits collect_ray_hits(Device& device, const PosedScene& posed_scene, const WorldRays& rays,
                               std::uint32_t max_hits_per_ray);

}  // namespace relidar
