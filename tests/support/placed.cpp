// SPDX-License-Identifier: Apache-2.0
#include "placed.hpp"

namespace relidar::test {

SceneAndPoses to_scene(const Surfels& surfels, const std::vector<reference::Placement>& placements) {
    SceneAndPoses result;
    std::vector<reference::Placement> ranges;  // surfel ranges of the models
    for (const reference::Placement& p : placements) {
        std::uint32_t model = 0;
        while (model < ranges.size() && (ranges[model].first != p.first || ranges[model].count != p.count))
            ++model;
        if (model == ranges.size()) {
            ranges.push_back(p);
            result.scene.models.push_back(
                {"model " + std::to_string(model), std::uint32_t(result.original.size()), p.count});
            for (std::uint32_t i = 0; i < p.count; ++i) result.original.push_back(p.first + i);
        }
        result.scene.instances.push_back({model, ""});
        const reference::Motion& m = p.motion;
        result.world_from_instance.push_back(
            {.world_from_model = p.world_from_model,
             .motion = {m.velocity, m.angular_velocity, m.middle_s, m.half_span_s}});
    }
    result.scene.surfels = take(surfels, result.original);
    return result;
}

SceneAndPoses to_scene(const reference::World& world) {
    return to_scene(to_surfels(world.surfels), world.instances);
}

WorldRays to_world_rays(const std::vector<reference::Ray>& rays) {
    WorldRays result;
    for (const reference::Ray& ray : rays) {
        result.origin.push_back(glm::vec3(ray.origin));
        result.direction.push_back(glm::vec3(ray.direction));
        result.time_s.push_back(float(ray.time_s));
    }
    return result;
}

std::vector<shared::DeviceTarget> to_targets(const std::vector<reference::Ray>& rays) {
    std::vector<shared::DeviceTarget> targets;
    for (const reference::Ray& ray : rays) {
        const bool unknown = ray.measured_m <= 0.0 && targets.size() % 2 == 0;
        targets.push_back({unknown ? 5.0f : float(ray.measured_m), 0.5f, unknown ? 0.0f : 1.0f});
    }
    return targets;
}

}  // namespace relidar::test
