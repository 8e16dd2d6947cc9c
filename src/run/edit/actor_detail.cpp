// SPDX-License-Identifier: Apache-2.0
// Compares the number of rays that hit the box of an actor, when it is nearest to a
// LiDAR, with its number of surfels.
#include <relidar/run/edit.hpp>

#include <algorithm>
#include <limits>

#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "base/geometry/ray_box.hpp"

namespace relidar {

/// Counts the rays that hit the box of an actor, all fired from one pose of the sensor.
/// @param ray_origins, ray_directions  in the sensor frame
ActorModelResolution model_resolution(std::span<const glm::vec3> ray_origins,
                                      std::span<const glm::vec3> ray_directions, const Pose& box_from_sensor,
                                      const glm::dvec3& size_m, std::size_t n_surfels) {
    ActorModelResolution detail{.nearest_m = glm::length(box_from_sensor.translation), .surfels = n_surfels};
    const glm::dvec3 centre_m = inverse(box_from_sensor).translation;  // of the box, in the sensor frame
    // Most rays miss the bounding sphere of the box, which is a fast test. The sphere is
    // a little larger, because directions are in single precision.
    const double radius_m = 0.5 * glm::length(size_m) * 1.001 + 0.01;
    for (std::size_t i = 0; i < ray_directions.size(); ++i) {
        const glm::dvec3 origin_m(ray_origins[i]), direction(ray_directions[i]);
        if (!passes_sphere(origin_m, direction, centre_m, radius_m)) continue;
        const auto crossing = cross_box(box_from_sensor * origin_m, box_from_sensor.rotation * direction,
                                        -0.5 * size_m, 0.5 * size_m);
        const bool is_ahead = crossing && crossing->leave >= 0.0;  // false: the box is behind the ray
        if (is_ahead) ++detail.rays;
    }
    return detail;
}

/// Compares the model with the rays of the sweep in which the actor is nearest to the
/// LiDAR. Counts 0 rays at an infinite distance if it is in no frame of this LiDAR.
/// @throws UsageError if the scene has no such actor
ActorModelResolution model_resolution(const SceneWithLog& edited, const std::string& track, int lidar) {
    const Log& log = edited.log;
    const auto instance = std::ranges::find(edited.scene.instances, track, &ModelInstance::track);
    const BoxTrack* box = find_box(log, track);
    if (instance == edited.scene.instances.end() || !box)
        fail<UsageError>("cannot inspect actor \"{}\": the scene has no actor with this track id", track);
    const std::size_t n_surfels = edited.scene.models[instance->model].count;
    const PoseTrack world_from_sensor = log.lidar_track(lidar);
    const Frame* nearest = nullptr;
    Pose box_from_sensor;  // in the nearest frame
    for (const Frame& frame : log.frames) {
        if (frame.lidar != lidar || !box->is_observed(frame.time_s)) continue;
        const Pose pose =
            inverse(box->world_from_box.pose_at(frame.time_s)) * world_from_sensor.pose_at(frame.time_s);
        if (nearest && glm::length(pose.translation) >= glm::length(box_from_sensor.translation)) continue;
        box_from_sensor = pose;
        nearest = &frame;
    }
    if (!nearest) return {.nearest_m = std::numeric_limits<double>::infinity(), .surfels = n_surfels};
    const RayTable rays = make_lidar_rays(log.lidars[std::size_t(lidar)], nearest->time_s);
    // Counts the rays that hit the box.
    ActorModelResolution detail =
        model_resolution(rays.origin, rays.direction, box_from_sensor, box->size_m, n_surfels);
    detail.time_s = nearest->time_s;
    return detail;
}

std::string describe_unseen(const Scene& scene, const std::string& track_id) {
    const auto actor = std::ranges::find(scene.instances, track_id, &ModelInstance::track);
    if (actor == scene.instances.end() || !scene.models[actor->model].surface) return "";
    const std::optional<ObservedBoxSurface>& surface = scene.models[actor->model].surface;
    std::vector<std::string> mirrored, sentences;
    for (std::size_t s = 0; s < kBoxSides; ++s) {
        const double share = surface->mirrorable_fraction(BoxSide(s));  // not observed, but its mirror image
        if (surface->is_completed && share >= double(kUnseenSide))
            mirrored.push_back(fmt::format("{:.0f} % of the {}", 100.0 * share, name_of(BoxSide(s))));
    }
    if (!mirrored.empty())
        sentences.push_back(fmt::format(
            "actor {}: the log did not observe these parts of it, so they are mirror images of the other "
            "side: {}",
            track_id, fmt::join(mirrored, ", ")));
    const std::string empty_sides = list_unseen_sides(surface->covered_sides());
    if (!empty_sides.empty())
        sentences.push_back(fmt::format(
            "actor {}: the log did not observe these sides of it: {}; they have no surfels, so rays pass "
            "through them",
            track_id, empty_sides));
    return fmt::format("{}", fmt::join(sentences, "; "));
}

}  // namespace relidar
