// SPDX-License-Identifier: Apache-2.0
// Converts between the surfels of the library and the surfels of the reference
// (docs/method.md section 2 lists the 58 numbers).
#include "surfels.hpp"

namespace relidar::test {

std::vector<reference::Surfel> to_reference(const Surfels& surfels) {
    std::vector<reference::Surfel> result(surfels.mean.size());
    for (std::size_t i = 0; i < result.size(); ++i) {
        reference::Surfel& s = result[i];
        s.mean = glm::dvec3(surfels.mean[i]);
        s.rotation = glm::dvec4(surfels.rotation[i]);
        s.log_scale = glm::dvec2(surfels.log_scale[i]);
        s.opacity_logit = double(surfels.opacity_logit[i]);
        if (properties_of(surfels.primitive).third_scale) s.log_scale_w = double(surfels.log_scale_w[i]);
        if (surfels.bends) {
            const GaitPhaseWindow& gait = surfels.gait[i];
            s.gait_phase = double(gait.phase);
            s.gait_sharpness = double(gait.sharpness);
            s.gait_swing = glm::dvec3(gait.swing);
        }
        for (int k = 0; k < kShFloats; ++k) s.sh[k] = double(surfels.sh[i * kShFloats + k]);
    }
    return result;
}

Surfels to_surfels(const std::vector<reference::Surfel>& surfels) {
    Surfels result;
    for (const reference::Surfel& s : surfels) {
        result.mean.emplace_back(s.mean);
        result.rotation.emplace_back(s.rotation);
        result.log_scale.emplace_back(s.log_scale);
        result.opacity_logit.push_back(float(s.opacity_logit));
        result.gait.push_back({float(s.gait_phase), float(s.gait_sharpness), glm::vec3(s.gait_swing)});
        result.bends = result.bends || s.gait_sharpness != 0.0 || s.gait_swing != glm::dvec3(0.0);
        result.sh.insert(result.sh.end(), s.sh.begin(), s.sh.end());
        if (!s.log_scale_w) continue;
        result.primitive = PrimitiveType::gaussian;
        result.log_scale_w.push_back(float(*s.log_scale_w));
    }
    if (!result.bends) result.gait.clear();
    return result;
}

std::vector<reference::Ray> to_reference(const WorldRays& rays) {
    std::vector<reference::Ray> result;
    for (std::size_t i = 0; i < rays.size(); ++i)
        result.push_back({glm::dvec3(rays.origin[i]), glm::dvec3(rays.direction[i]), 0.0,
                          rays.time_s.empty() ? 0.0 : double(rays.time_s[i])});
    return result;
}

WorldRays to_world_rays(const RayTable& table) {
    return {to_vector(table.origin), to_vector(table.direction)};
}

Surfels take(const Surfels& surfels, const std::vector<std::uint32_t>& order) {
    Surfels result;
    result.primitive = surfels.primitive;
    for (const std::uint32_t i : order) {
        result.mean.push_back(surfels.mean[i]);
        result.rotation.push_back(surfels.rotation[i]);
        result.log_scale.push_back(surfels.log_scale[i]);
        result.opacity_logit.push_back(surfels.opacity_logit[i]);
        if (properties_of(surfels.primitive).third_scale)
            result.log_scale_w.push_back(surfels.log_scale_w[i]);
        const auto sh = surfels.sh.begin() + std::ptrdiff_t(i) * kShFloats;
        result.sh.insert(result.sh.end(), sh, sh + kShFloats);
    }
    return result;
}

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
