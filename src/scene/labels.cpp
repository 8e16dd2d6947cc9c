// SPDX-License-Identifier: Apache-2.0

#include <relidar/scene/labels.hpp>

#include <algorithm>
#include <span>

#include <relidar/scene/scene.hpp>

#include "base/geometry/ray_box.hpp"
#include "base/list_text.hpp"
#include "base/median.hpp"

namespace relidar {
namespace {

constexpr double kGroundHeight_m = 0.15;  // points in the lowest part of a box belong to the ground

/// Returns the corners of the part of a box that contains the points of the object.
std::pair<glm::dvec3, glm::dvec3> object_corners(const glm::dvec3& size_m) {
    const glm::dvec3 half_m = 0.5 * size_m + kObjectMargin_m;
    return {{-half_m.x, -half_m.y, -0.5 * size_m.z + kGroundHeight_m}, half_m};
}

/// Returns the median position of a track, with the rotation of the nearest pose.
Pose median_pose(const PoseTrack& track) {
    glm::dvec3 middle_m;
    for (int axis = 0; axis < 3; ++axis) {
        std::vector<double> values;
        for (const Pose& pose : track.pose) values.push_back(pose.translation[axis]);
        middle_m[axis] = compute_median(std::move(values));
    }
    // A median of rotations is not defined, so the nearest pose supplies its rotation.
    const auto distance_m = [&](const Pose& pose) { return glm::distance(pose.translation, middle_m); };
    return {std::ranges::min_element(track.pose, {}, distance_m)->rotation, middle_m};
}

}  // namespace

bool is_on_object(const glm::dvec3& point_m, const glm::dvec3& size_m) {
    const auto [low_m, high_m] = object_corners(size_m);
    return glm::all(glm::greaterThanEqual(point_m, low_m)) && glm::all(glm::lessThanEqual(point_m, high_m));
}

std::optional<glm::dvec2> object_interval(const glm::dvec3& origin_m, const glm::dvec3& direction,
                                          const glm::dvec3& size_m) {
    const auto [low_m, high_m] = object_corners(size_m);
    const auto inside = cross_box(origin_m, direction, low_m, high_m);
    if (!inside || inside->leave < 0.0) return {};
    return glm::dvec2(std::max(inside->enter, 0.0), inside->leave);
}

std::vector<std::string> actor_names(const Scene& scene) {
    std::vector<std::string> names;
    for (const ModelInstance& instance : scene.instances)
        if (!instance.track.empty()) names.push_back(instance.track);  // the background has no track
    return names;
}

std::vector<BoxTrack> list_standing(const Scene& scene, const Log& log, const InitOptions& options) {
    const std::vector<std::string> actor_tracks = split_list(options.actor_tracks);
    std::vector<BoxTrack> standing;
    for (const BoxTrack& box : log.boxes) {
        // Training removes the points of selected tracks from the background.
        const bool is_removed = std::ranges::find(actor_tracks, box.id) != actor_tracks.end();
        const bool has_model =
            std::ranges::find(scene.instances, box.id, &ModelInstance::track) != scene.instances.end();
        if (box.world_from_box.pose.empty() || is_removed || has_model || box.is_moving()) continue;
        standing.push_back(box);
        standing.back().world_from_box = {{box.world_from_box.time_s.front()},
                                          {median_pose(box.world_from_box)}};
    }
    return standing;
}

}  // namespace relidar
