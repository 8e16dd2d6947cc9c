// SPDX-License-Identifier: Apache-2.0
#include "placed.hpp"

namespace relidar::test {

SceneAndPoses to_scene(Surfels surfels, const std::vector<reference::Placement>& placements) {
    SceneAndPoses result;
    for (const reference::Placement& p : placements) {
        std::uint32_t model = 0;
        while (model < result.scene.models.size() && (result.scene.models[model].first != p.first || result.scene.models[model].count != p.count)) ++model;
        if (model == result.scene.models.size()) result.scene.models.push_back({"model " + std::to_string(model), p.first, p.count});
        result.scene.instances.push_back({model, ""});
        result.world_from_instance.push_back(p.world_from_model);
    }
    result.scene.surfels = std::move(surfels);
    return result;
}

WorldRays to_world_rays(const std::vector<reference::Ray>& rays) {
    WorldRays result;
    for (const reference::Ray& ray : rays) {
        result.origin.push_back(glm::vec3(ray.origin));
        result.direction.push_back(glm::vec3(ray.direction));
    }
    return result;
}

}  // namespace relidar::test
