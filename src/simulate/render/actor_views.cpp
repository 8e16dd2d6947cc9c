// SPDX-License-Identifier: Apache-2.0
// Measures how much of each actor a scan shows. Compares the rays that hit the actor with
// the rays that would hit it if the scene contained nothing else.
#include <algorithm>

#include "simulate/render/footprint.hpp"
#include "simulate/render/render_lanes.hpp"
#include "simulate/render/scan_renderer.hpp"

namespace relidar {
namespace {

struct FiredRay {
    glm::dvec3 origin, direction;
};

std::vector<FiredRay> list_fired_rays(const Sweep& sweep) {
    const RayTable& rays = sweep.rays();
    std::vector<FiredRay> in_world;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const Pose pose = sweep.world_from_sensor.at(sweep.time_s + double(rays.time_offset_s[i]));
        in_world.push_back(
            {pose * glm::dvec3(rays.origin[i]), pose.rotation * glm::dvec3(rays.direction[i])});
    }
    return in_world;
}

/// Returns the indices of the rays that pass near a model. The test uses a sphere that
/// contains the model during the full sweep.
std::vector<std::size_t> find_rays_near(const std::vector<FiredRay>& rays, const Sweep& sweep,
                                        const InstancePose& placed, double model_radius_m) {
    const auto [first_s, last_s] = std::ranges::minmax(sweep.rays().time_offset_s);
    const glm::dvec3 begin_m = placed.motion.at(placed.world_from_model, double(first_s)).translation,
                     end_m = placed.motion.at(placed.world_from_model, double(last_s)).translation;
    const double radius_m = model_radius_m + 0.5 * glm::distance(begin_m, end_m);
    std::vector<std::size_t> near;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const glm::dvec3 to_centre_m = 0.5 * (begin_m + end_m) - rays[i].origin;
        const double along_m = glm::dot(to_centre_m, rays[i].direction);
        if (along_m > -radius_m &&
            glm::dot(to_centre_m, to_centre_m) - along_m * along_m < radius_m * radius_m)
            near.push_back(i);
    }
    return near;
}

}  // namespace

/// Counts the rays of a scan whose first hit is on each instance. A ray at the edge of an
/// actor counts only if surfaces absorb at least half of its light.
std::vector<ActorView> ScanRenderer::Impl::count_first_hits(const RenderedScan& scan) const {
    std::vector<ActorView> views;
    for (const Instance& instance : sweeps.layout().instances) views.push_back({instance.track});
    for (std::size_t ray = 0; ray < scan.instance.size(); ++ray)
        if (scan.instance[ray] >= 0 && scan.weight[ray] >= 0.5f &&
            is_returned(scan.image.drop_prob[ray], scan.median_range_m[ray]))
            ++views[std::size_t(scan.instance[ray])].n_rays;
    return views;
}

/// Traces the rays near each actor in a scene that contains only this actor, and counts
/// their hits. Then removes the entries of the background and of actors without hits.
void ScanRenderer::Impl::count_isolated_actor_hits(const Sweep& sweep, const ScanPlan& plan,
                                                   std::vector<ActorView>& views) {
    const std::vector<FiredRay> rays = list_fired_rays(sweep);
    for (std::size_t i = 0; i < views.size() && !rays.empty(); ++i) {
        if (views[i].track.empty() || !sweep.instances[i].present) continue;
        const Model& model = sweeps.layout().models[sweeps.layout().instances[i].model];
        const std::vector<std::size_t> near =
            find_rays_near(rays, sweep, sweep.instances[i], double(glm::length(model.half_size_m)));
        if (near.empty()) continue;
        Sweep alone = sweep;
        alone.changed_rays = select_rays(sweep.rays(), near);
        for (std::size_t k = 0; k < views.size(); ++k) alone.instances[k].present = k == i;
        load_scene(lanes->first(), alone);
        const RenderedScan scan =
            plan.splits_beams() ? trace_beams(alone, plan.beams) : trace(alone, alone.rays()).scan;
        views[i].n_rays_alone = count_first_hits(scan)[i].n_rays;
    }
    std::erase_if(views, [](const ActorView& view) { return view.track.empty() || view.n_rays_alone == 0; });
    load_scene(lanes->first(), sweep);
}

}  // namespace relidar
