// SPDX-License-Identifier: Apache-2.0
// Counts the rays of a scan that meet an unobserved side of an actor. The log has no
// points on such a side. Either mirrored surfels complete the side, or rays pass through
// it.
#include <relidar/simulate/render.hpp>

#include "base/geometry/ray_box.hpp"

namespace relidar {
namespace {

// With fewer rays, the side is not reported.
constexpr std::size_t kFewestRays = 5;

struct PartlyObservedActor {
    const BoxTrack* box;
    const ObservedBoxSurface* surface;
    std::int32_t instance;                ///< index of the actor in Scene::instances
    ObservedSideFractions side_coverage;  ///< observed or mirrored fraction of each side
    /// bounding sphere of the box at the times of the first and of the last ray, in the
    /// world frame
    glm::dvec3 centre_m{0.0};
    double radius_m = 0.0;
    /// [sides] rays that enter through an unobserved side, and rays that hit mirrored
    /// surfels, which complete a side
    std::array<std::size_t, kBoxSides> n_unobserved{}, n_mirrored{};

    /// Counts a ray of a scan if it sees a side that the log has not observed.
    void count_ray(const RenderedScan& scan, std::size_t ray, const WorldRay& in_world) {
        if (!passes_sphere(in_world.origin_m, in_world.direction, centre_m, radius_m)) return;
        const double firing_time_s = scan.time_s + double(scan.time_offset_s[ray]),
                     range_m = double(scan.median_range_m[ray]);  // 0 if the ray hits nothing
        const Pose box_from_world = inverse(box->world_from_box.pose_at(firing_time_s));
        const glm::dvec3 origin = box_from_world * in_world.origin_m,
                         direction = box_from_world.rotation * in_world.direction;
        const bool hits_actor = !scan.instance.empty() && scan.instance[ray] == instance;
        if (hits_actor && range_m > 0.0)
            if (const auto side = surface->find_mirrored_side(origin + range_m * direction))
                ++n_mirrored[std::size_t(*side)];
        const glm::dvec3 half_m = 0.5 * box->size_m;
        const std::optional<BoxCrossing> inside = cross_box(origin, direction, -half_m, half_m);
        const bool starts_outside = inside && inside->enter > 0.0;
        if (!starts_outside || (range_m > 0.0 && range_m < inside->enter)) return;
        for (std::size_t s = 0; s < kBoxSides; ++s) {
            // The ray enters through this side, and not at a grazing angle.
            const bool enters = kSideFrames[s].normal == inside->axis &&
                                -kSideFrames[s].sign * direction[inside->axis] >= min_cosine(BoxSide(s));
            if (enters && side_coverage[s] < kUnseenSide) ++n_unobserved[s];
        }
    }
};

/// Lists the present actors that have an unobserved side or mirrored surfels.
std::vector<PartlyObservedActor> list_partly_observed(const RenderedScan& scan, const Scene& scene,
                                                      const Log& log) {
    std::vector<PartlyObservedActor> actors;
    if (scan.time_offset_s.empty()) return actors;
    const auto [first_s, last_s] = std::ranges::minmax(scan.time_offset_s);
    for (std::size_t i = 0; i < scene.instances.size(); ++i) {
        const ModelInstance& instance = scene.instances[i];
        const std::optional<ObservedBoxSurface>& surface = scene.models[instance.model].surface;
        const BoxTrack* box = find_box(log, instance.track);
        if (!box || !box->is_observed(scan.time_s) || !surface) continue;
        const ObservedSideFractions coverage = surface->covered_sides();
        if (list_unseen_sides(coverage).empty() && !surface->is_completed) continue;
        const glm::dvec3 begin_m = box->world_from_box.pose_at(scan.time_s + double(first_s)).translation,
                         end_m = box->world_from_box.pose_at(scan.time_s + double(last_s)).translation;
        actors.push_back({.box = box,
                          .surface = &*surface,
                          .instance = std::int32_t(i),
                          .side_coverage = coverage,
                          .centre_m = 0.5 * (begin_m + end_m),
                          .radius_m = 0.5 * (glm::length(box->size_m) + glm::distance(begin_m, end_m))});
    }
    return actors;
}

}  // namespace

UnobservedActorSides find_unseen_sides(const RenderedScan& scan, const Scene& scene, const Log& log) {
    std::vector<PartlyObservedActor> actors = list_partly_observed(scan, scene, log);
    if (actors.empty()) return {};
    // Boxes are in the world frame, but the poses of a scan are in the dataset's frame.
    FiringPoseInterpolator world_from_firing(scan, Pose{glm::dquat(1.0, 0.0, 0.0, 0.0), -log.world_offset_m});
    for (std::size_t i = 0; i < scan.image.range_m.size(); ++i) {
        const Pose& pose = world_from_firing.pose_of(i);
        const WorldRay ray{pose * glm::dvec3(scan.image.origin[i]),
                           pose.rotation * glm::dvec3(scan.image.direction[i])};
        for (PartlyObservedActor& actor : actors) actor.count_ray(scan, i, ray);
    }
    UnobservedActorSides sides;
    const auto report = [&](const std::string& track, std::size_t side, std::size_t n_rays,
                            bool is_completed) {
        if (n_rays >= kFewestRays) sides.push_back({track, BoxSide(side), n_rays, is_completed});
    };
    for (const PartlyObservedActor& actor : actors)
        for (std::size_t s = 0; s < kBoxSides; ++s) {
            report(actor.box->id, s, actor.n_unobserved[s], /*is_completed=*/false);
            report(actor.box->id, s, actor.n_mirrored[s], /*is_completed=*/true);
        }
    return sides;
}

}  // namespace relidar
