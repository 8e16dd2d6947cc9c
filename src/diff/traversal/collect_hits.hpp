// SPDX-License-Identifier: Apache-2.0
// The traversal contract made visible for its conformance tests
// (shaders/diff/traversal/README.md).
#pragma once

#include <cstdint>
#include <vector>

#include <relidar/diff/accel.hpp>
#include <relidar/diff/traversal.hpp>
#include <relidar/scene/device_scene.hpp>

namespace relidar {

/// Ordered hits of each ray, all of them: for tests of the traversal contract.
struct CollectedHits {
    std::uint32_t max_hits = 0;
    std::vector<std::uint32_t> counts;    ///< [n_rays] may exceed max_hits
    std::vector<float> t;                 ///< [n_rays, max_hits] metres
    std::vector<std::uint32_t> instance;  ///< [n_rays, max_hits]
    std::vector<std::uint32_t> surfel;    ///< [n_rays, max_hits]
};

/// A scene with its instances placed, and how it is traced.
struct PlacedScene {
    const Scene* scene = nullptr;
    std::vector<InstancePose> world_from_instance;
    ImageModel model;
    AccelOptions accel;
    TraceOptions trace;
};

/// @param max_hits  hits kept a ray; all are counted @throws DeviceError where a ray
/// reaches the cap of passes
CollectedHits collect_hits(Device& device, const PlacedScene& placed, const WorldRays& rays,
                           std::uint32_t max_hits);

}  // namespace relidar
