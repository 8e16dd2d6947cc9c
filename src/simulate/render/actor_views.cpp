// SPDX-License-Identifier: Apache-2.0
// Measures how much of each actor is visible in a scan. Divides the number of rays that
// hit the actor by the number that would hit it if the scene contained nothing else.

#include "simulate/render/footprint.hpp"
#include "simulate/render/render_lanes.hpp"
#include "simulate/render/scan_renderer.hpp"

namespace relidar {
namespace {

struct FiredRay {
    glm::dvec3 origin, direction;
};

/// Returns the rays of a sweep in the world frame of the scene, each at its firing time.
std::vector<FiredRay> fired_rays(const SimulatedSweep& sweep) {
    const RayTable& rays = sweep.rays();
    std::vector<FiredRay> in_world;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const Pose pose = sweep.world_from_sensor.pose_at(sweep.time_s + double(rays.time_offset_s[i]));
        in_world.push_back(
            {pose * glm::dvec3(rays.origin[i]), pose.rotation * glm::dvec3(rays.direction[i])});
    }
    return in_world;
}

/// Returns the indices of the rays that pass near a model. The test uses a sphere that
/// contains the model during the full sweep.
RayIndices rays_near(const std::vector<FiredRay>& rays, const SimulatedSweep& sweep, const InstancePose& pose,
                     double model_radius_m) {
    const auto [first_s, last_s] = std::ranges::minmax(sweep.rays().time_offset_s);
    const glm::dvec3 begin_m = pose.motion.pose_at(pose.world_from_model, double(first_s)).translation,
                     end_m = pose.motion.pose_at(pose.world_from_model, double(last_s)).translation;
    const double radius_m = model_radius_m + 0.5 * glm::distance(begin_m, end_m);
    RayIndices nearby;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const glm::dvec3 to_centre_m = 0.5 * (begin_m + end_m) - rays[i].origin;
        const double along_m = glm::dot(to_centre_m, rays[i].direction);
        if (along_m > -radius_m &&
            glm::dot(to_centre_m, to_centre_m) - along_m * along_m < radius_m * radius_m)
            nearby.push_back(i);
    }
    return nearby;
}

}  // namespace

/// Counts for each instance the rays that return from it. A ray at the edge of an actor
/// counts only if surfaces absorb at least half of its light.
ActorViews ScanRenderer::Impl::count_first_hits(const RenderedScan& scan) const {
    ActorViews views;
    for (const ModelInstance& instance : sweeps.layout().instances) views.push_back({instance.track});
    for (std::size_t ray = 0; ray < scan.instance.size(); ++ray)
        if (scan.instance[ray] >= 0 && scan.weight[ray] >= 0.5f &&
            is_ray_returned(scan.image.drop_prob[ray], scan.median_range_m[ray]))
            ++views[std::size_t(scan.instance[ray])].n_rays;
    return views;
}

/// For each actor, traces the nearby rays in a scene that contains only this actor, and
/// counts their hits. Then removes the background and actors without hits from `views`.
void ScanRenderer::Impl::count_unoccluded(const SimulatedSweep& sweep, const ScanRenderPlan& plan,
                                          ActorViews& views) {
    const std::vector<FiredRay> rays = fired_rays(sweep);
    for (std::size_t i = 0; i < views.size() && !rays.empty(); ++i) {
        if (views[i].track.empty() || !sweep.instances[i].present) continue;
        const SurfelModel& model = sweeps.layout().models[sweeps.layout().instances[i].model];
        const RayIndices nearby =
            rays_near(rays, sweep, sweep.instances[i], double(glm::length(model.half_size_m)));
        if (nearby.empty()) continue;
        SimulatedSweep alone = sweep;
        alone.changed_rays = select_rays(sweep.rays(), nearby);
        for (std::size_t k = 0; k < views.size(); ++k) alone.instances[k].present = k == i;
        prepare_scene(lanes->single_lane(), alone);
        const RenderedScan scan =
            plan.has_sub_rays() ? trace_footprint(alone, plan.beams) : trace_rays(alone, alone.rays()).scan;
        views[i].n_rays_alone = count_first_hits(scan)[i].n_rays;
    }
    std::erase_if(views,
                  [](const ActorVisibility& view) { return view.track.empty() || view.n_rays_alone == 0; });
    // Restores the instances of the full scene for the steps that follow.
    prepare_scene(lanes->single_lane(), sweep);
}

}  // namespace relidar
