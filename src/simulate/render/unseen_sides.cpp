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
    const std::string* track;
    const PoseTrack* world_from_box;
    glm::dvec3 half_m;
    const ObservedBoxSurface* surface;
    std::int32_t instance;                ///< index of the actor in Scene::instances
    ObservedSideFractions side_coverage;  ///< observed or completed fraction of each side
    /// bounding sphere of the box during the scan, in the world frame
    glm::dvec3 centre_m{0.0};
    double radius_m = 0.0;
    /// rays that enter through an unobserved side, and rays that hit its mirrored surfels
    std::array<std::size_t, kBoxSides> n_through{}, n_completed{};

    /// Counts a ray if it sees a side of the actor that the log has not observed. Such a
    /// side is either filled with mirrored surfels or left empty. All coordinates are in
    /// the box frame.
    /// @param range_m range of the return; 0 if the ray has no return
    /// @param hits_actor true if the return is a surface of this actor
    void count_ray(const glm::dvec3& origin, const glm::dvec3& direction, double range_m, bool hits_actor) {
        if (hits_actor && range_m > 0.0) {
            const auto mirrored_side = surface->find_mirrored_side(origin + range_m * direction);
            if (mirrored_side) ++n_completed[std::size_t(*mirrored_side)];
        }
        const std::optional<BoxCrossing> inside = cross_box(origin, direction, -half_m, half_m);
        const bool starts_outside = inside && inside->enter > 0.0;
        if (!starts_outside || (range_m > 0.0 && range_m < inside->enter)) return;
        for (std::size_t s = 0; s < kBoxSides; ++s) {
            // The ray enters through this side, and not at a grazing angle.
            const bool enters = kSideFrames[s].normal == inside->axis &&
                                -kSideFrames[s].sign * direction[inside->axis] >= min_cosine(BoxSide(s));
            if (enters && side_coverage[s] < kUnseenSide) ++n_through[s];
        }
    }
};

/// Lists the present actors that have an unobserved side or mirrored surfels.
std::vector<PartlyObservedActor> partly_seen(const RenderedScan& scan, const Scene& scene, const Log& log) {
    std::vector<PartlyObservedActor> boxes;
    if (scan.time_offset_s.empty()) return boxes;
    const auto [first_s, last_s] = std::ranges::minmax(scan.time_offset_s);
    for (std::size_t i = 0; i < scene.instances.size(); ++i) {
        const ModelInstance& instance = scene.instances[i];
        const std::optional<ObservedBoxSurface>& surface = scene.models[instance.model].surface;
        const BoxTrack* box = instance.track.empty() ? nullptr : find_box(log, instance.track);
        if (!box || !box->is_observed(scan.time_s) || !surface) continue;
        const ObservedSideFractions coverage = surface->covered_sides();
        if (list_unseen_sides(coverage).empty() && !surface->is_completed) continue;
        // The sphere contains the box at the times of the first and of the last ray.
        const glm::dvec3 begin_m = box->world_from_box.pose_at(scan.time_s + double(first_s)).translation,
                         end_m = box->world_from_box.pose_at(scan.time_s + double(last_s)).translation;
        boxes.push_back({.track = &box->id,
                         .world_from_box = &box->world_from_box,
                         .half_m = 0.5 * box->size_m,
                         .surface = &*surface,
                         .instance = std::int32_t(i),
                         .side_coverage = coverage,
                         .centre_m = 0.5 * (begin_m + end_m),
                         .radius_m = 0.5 * (glm::length(box->size_m) + glm::distance(begin_m, end_m))});
    }
    return boxes;
}

}  // namespace

UnobservedActorSides find_unseen_sides(const RenderedScan& scan, const Scene& scene, const Log& log) {
    std::vector<PartlyObservedActor> boxes = partly_seen(scan, scene, log);
    // This pose converts firing poses from the dataset's frame to the world frame.
    FiringPoseInterpolator firing(scan, Pose{glm::dquat(1.0, 0.0, 0.0, 0.0), -log.world_offset_m});
    for (std::size_t i = 0; !boxes.empty() && i < scan.image.range_m.size(); ++i) {
        const Pose& world_from_firing = firing.pose_of(i);
        const glm::dvec3 origin = world_from_firing * glm::dvec3(scan.image.origin[i]),
                         direction = world_from_firing.rotation * glm::dvec3(scan.image.direction[i]);
        for (PartlyObservedActor& box : boxes) {
            if (!passes_sphere(origin, direction, box.centre_m, box.radius_m)) continue;
            // Each ray meets the box at the pose that the box has at the firing time.
            const Pose box_from_world =
                inverse(box.world_from_box->pose_at(scan.time_s + double(scan.time_offset_s[i])));
            box.count_ray(box_from_world * origin, box_from_world.rotation * direction,
                          double(scan.median_range_m[i]),
                          !scan.instance.empty() && scan.instance[i] == box.instance);
        }
    }
    UnobservedActorSides sides;
    for (const PartlyObservedActor& box : boxes)
        for (std::size_t s = 0; s < kBoxSides; ++s) {
            if (box.n_through[s] >= kFewestRays)
                sides.push_back({*box.track, BoxSide(s), box.n_through[s], /*is_completed=*/false});
            if (box.n_completed[s] >= kFewestRays)
                sides.push_back({*box.track, BoxSide(s), box.n_completed[s], /*is_completed=*/true});
        }
    return sides;
}

}  // namespace relidar
