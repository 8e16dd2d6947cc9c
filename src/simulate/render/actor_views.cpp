// SPDX-License-Identifier: Apache-2.0
// Measures how much of each actor is visible in a scan. Divides the number of rays that
// hit the actor by the number that would hit it if the scene contained nothing else. Both
// numbers leave out the soft edge of the surfels around the box and below the ground. For
// standing objects, which are part of the background, estimates the latter number.
#include <relidar/scene/labels.hpp>

#include "base/geometry/ray_box.hpp"
#include "simulate/render/footprint.hpp"
#include "simulate/render/render_lanes.hpp"
#include "simulate/render/scan_renderer.hpp"

namespace relidar {
namespace {

/// Returns the rays of a sweep in the world frame of the scene, each at its firing time.
std::vector<WorldRay> fired_rays(const SimulatedSweep& sweep) {
    std::vector<WorldRay> in_world;
    for (std::size_t i = 0; i < sweep.rays().size(); ++i)
        in_world.push_back(make_world_ray(sweep.world_from_sensor, sweep.time_s, sweep.rays(), i, true));
    return in_world;
}

/// Returns the indices of the rays that pass near a model. The test uses a sphere that
/// contains the model during the full sweep.
RayIndices rays_near(const std::vector<WorldRay>& rays, const SimulatedSweep& sweep, const InstancePose& pose,
                     double model_radius_m) {
    const auto [first_s, last_s] = std::ranges::minmax(sweep.rays().time_offset_s);
    // Positions of the model at the start and at the end of the sweep.
    const glm::dvec3 begin_m = pose.motion.pose_at(pose.world_from_model, double(first_s)).translation,
                     end_m = pose.motion.pose_at(pose.world_from_model, double(last_s)).translation;
    const double radius_m = model_radius_m + 0.5 * glm::distance(begin_m, end_m);
    RayIndices nearby;
    for (std::size_t i = 0; i < rays.size(); ++i)
        if (passes_sphere(rays[i].origin_m, rays[i].direction, 0.5 * (begin_m + end_m), radius_m))
            nearby.push_back(i);
    return nearby;
}

/// Returns true if a ray meets an instance first: if surfaces absorb at least half of its
/// light, and the sensor can measure the range. The probability of a return is not used,
/// because it depends on the brightness of the surface, not on what hides it.
bool meets_instance(const RenderedScan& scan, std::size_t ray, std::size_t instance) {
    return scan.instance[ray] == std::int32_t(instance) && scan.weight[ray] >= 0.5f &&
           scan.image.drop_prob[ray] < 1.0f;
}

/// Returns true if a ray of a scan ends at the object in the box of a model, see
/// is_on_object(). The soft edge of its surfels also reaches around the box.
bool is_on_model(const InstancePose& pose, const glm::dvec3& half_size_m, const WorldRay& ray,
                 const RenderedScan& scan, std::size_t index) {
    const Pose world_from_box = pose.motion.pose_at(pose.world_from_model, double(scan.time_offset_s[index]));
    const glm::dvec3 end_m = ray.origin_m + double(scan.median_range_m[index]) * ray.direction;
    // A model's box contains the margin.
    return is_on_object(inverse(world_from_box) * end_m, 2.0 * (half_size_m - kObjectMargin_m));
}

/// Rays that cross the box of a standing object.
struct CrossingRays {
    std::size_t n_blocked = 0;  ///< meet another object before they leave the box
    std::size_t n_hits = 0;     ///< meet the background in the box
    std::size_t n_dropped = 0;  ///< meet it there, but the sensor cannot measure the range
    std::size_t n_empty = 0;    ///< meet no surface before they leave the box

    /// Counts a ray of a scan.
    /// @param inside_m distances at which the ray enters (x) and leaves (y) the box
    void count_ray(const RenderedScan& scan, std::size_t ray, const glm::dvec2& inside_m) {
        const double range_m = double(scan.median_range_m[ray]);
        const bool hits_surface = scan.weight[ray] >= 0.5f && range_m > 0.0;
        if (!hits_surface || range_m > inside_m.y) ++n_empty;
        else if (scan.instance[ray] != 0 || range_m < inside_m.x) ++n_blocked;
        else if (meets_instance(scan, ray, 0)) ++n_hits;
        else ++n_dropped;
    }

    /// Returns the estimated visibility, or nothing if no ray would hit the object.
    std::optional<ActorVisibility> visibility(const std::string& track) const {
        constexpr std::size_t kMinEmptyRays = 5;  // fewer rays at an edge of the box can miss the object
        const std::size_t n_open = n_hits + n_dropped + n_empty;
        if (n_hits > 0)
            return ActorVisibility{track, n_hits, n_hits + (n_blocked * n_hits + n_open / 2) / n_open};
        if (n_dropped == 0 && n_empty >= kMinEmptyRays && n_empty > n_blocked)
            return ActorVisibility{track, 0, 0};
        return n_blocked > 0 ? std::optional(ActorVisibility{track, 0, n_blocked}) : std::nullopt;
    }
};

}  // namespace

/// Counts the rays of a scan that meet standing objects, and estimates how many would if
/// no other object hid them.
/// @param rays the rays of the scan in the world frame
void ScanRenderer::Impl::count_standing(const std::vector<WorldRay>& rays, const RenderedScan& scan,
                                        double max_range_m, ActorViews& views) const {
    for (const BoxTrack& box : standing) {
        const Pose &world_from_box = box.world_from_box.pose.front(),
                   box_from_world = inverse(world_from_box);
        // The sphere contains the box, which object_interval() enlarges on each side.
        const double radius_m = 0.5 * glm::length(box.size_m) + 2.0 * kObjectMargin_m;
        CrossingRays crossing;
        for (std::size_t i = 0; i < rays.size(); ++i) {
            if (!passes_sphere(rays[i].origin_m, rays[i].direction, world_from_box.translation, radius_m))
                continue;
            const std::optional<glm::dvec2> inside_m = object_interval(
                box_from_world * rays[i].origin_m, box_from_world.rotation * rays[i].direction, box.size_m);
            if (inside_m && inside_m->x <= max_range_m) crossing.count_ray(scan, i, *inside_m);
        }
        if (const auto view = crossing.visibility(box.id)) views.push_back(*view);
    }
}

/// Measures the visibility of actors, and of standing objects if the background is shown.
/// For each actor, traces the nearby rays again in a scene that contains only this actor.
/// @param plan of the scan; the rays are traced in the same way, but without a network
/// @param scan rays of the sweep, before a network or noise changes the drops
ActorViews ScanRenderer::Impl::count_views(const SimulatedSweep& sweep, ScanRenderPlan plan,
                                           const RenderedScan& scan) {
    plan.network = ScanRenderPlan::RayDropStage::none;
    const std::vector<WorldRay> rays = fired_rays(sweep);
    ActorViews views;
    const std::vector<ModelInstance>& instances = sweeps.layout().instances;
    for (std::size_t i = 0; i < instances.size() && !rays.empty(); ++i) {
        // The background has no track.
        if (instances[i].track.empty() || !sweep.instances[i].present) continue;
        const glm::dvec3 half_size_m(sweeps.layout().models[instances[i].model].half_size_m);
        const RayIndices nearby = rays_near(rays, sweep, sweep.instances[i], glm::length(half_size_m));
        if (nearby.empty()) continue;
        // The same sweep with only these rays, and with all other instances hidden. They
        // replace the rays of the sensor.
        SimulatedSweep alone = sweep;
        alone.changed_rays = select_rays(sweep.rays(), nearby);
        for (std::size_t k = 0; k < instances.size(); ++k) alone.instances[k].present = k == i;
        prepare_scene(lanes->first(), alone);
        const RenderedScan hits = plan.has_sub_rays() ? trace_footprint(alone, plan)
                                                      : trace_rays(alone, alone.rays(), plan.network).scan;
        ActorVisibility on_object{instances[i].track}, on_model = on_object;
        for (std::size_t k = 0; k < nearby.size(); ++k) {
            const bool is_hit = meets_instance(scan, nearby[k], i), is_alone = meets_instance(hits, k, i);
            on_model.n_rays += is_hit;
            on_model.n_rays_alone += is_hit || is_alone;
            if (!is_alone || !is_on_model(sweep.instances[i], half_size_m, rays[nearby[k]], hits, k))
                continue;
            on_object.n_rays += is_hit;
            ++on_object.n_rays_alone;
        }
        // If only the lowest part of the actor is in view, counts all rays.
        if (on_object.n_rays_alone == 0) on_object = on_model;
        if (on_object.n_rays_alone > 0) views.push_back(on_object);
    }
    prepare_scene(lanes->first(), sweep);  // shows the other instances again
    if (sweeps.is_background_shown()) count_standing(rays, scan, sweeps.limits_of(sweep.sensor).max_m, views);
    return views;
}

}  // namespace relidar
