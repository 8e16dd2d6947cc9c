// SPDX-License-Identifier: Apache-2.0
// Labels of the objects of a scene: their classes, labelled objects that stand still, the
// points that belong to an object, and surfels that stay in it.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/log/log.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

/// Class of an object, the same for all datasets.
enum class ObjectClass {
    car,
    van,
    truck,
    bus,
    trailer,
    cyclist,     ///< bicycle with or without a rider, or a rider
    motorcycle,  ///< with or without a rider
    pedestrian,
    other  ///< for example a tram
};
/// Returns the class of the object in a box. If the box has no label, guesses the class
/// from its size: vehicles are long, pedestrians and cyclists are narrow and tall.
ObjectClass class_of(const BoxTrack& box);
/// Returns the name of a class: Car, Van, Truck, Bus, Trailer, Cyclist, Motorcycle,
/// Pedestrian or Other.
const std::string& name_of(ObjectClass object_class);
/// Returns the names of all classes.
const std::vector<std::string>& list_object_classes();
/// Returns the coarser kind of object in a box, as class_of().
ObjectKind guess_kind(const BoxTrack& box);
/// Returns true for a moving object that the log does not label.
bool is_discovered(const BoxTrack& box);
/// Returns the name of the class in the dataset. Empty if is_discovered().
std::string label_of(const BoxTrack& box);

/// Margin around boxes in which points belong to the object. Some labelled boxes are too
/// small.
inline constexpr double kObjectMargin_m = 0.1;
/// Returns true if a point belongs to the object in a box: the point is in the box,
/// enlarged by kObjectMargin_m, and not in its lowest 0.15 m, which contains the ground.
/// @param point_m  in the frame of the box
bool is_on_object(const glm::dvec3& point_m, const glm::dvec3& size_m);
/// Interval of a line inside the part of a box where is_on_object() is true.
/// @param origin_m, direction  frame of the box
/// @return distances of entry and exit along the line; empty if the line misses the box
std::optional<glm::dvec2> object_interval(const glm::dvec3& origin_m, const glm::dvec3& direction,
                                          const glm::dvec3& size_m);

/// Returns the labelled objects that do not move and have no model, so that they are part
/// of the background. Each has one pose for all times, the median of its labels, because
/// labels jitter and the background does not move.
std::vector<BoxTrack> list_standing(const Scene& scene, const Log& log, const InitOptions& options);

/// Returns the names (track ids) of all actors, in the order of the scene's instances.
std::vector<std::string> actor_names(const Scene& scene);

/// Makes surfels fade earlier whose learned motion carries them out of their actor while
/// they are visible. Their opacity is then at most alpha_min as soon as their centre is
/// 0.2 m outside the box of the label.
void fade_far_swings(Scene& scene, float alpha_min);

/// Returns true for objects that are assumed to be symmetric: labelled vehicles, and
/// objects without a label that are at least 3 m long.
bool is_vehicle(const BoxTrack& box);

/// Returns a copy of the surfels, mirrored at the x-z plane: y becomes -y.
Surfels mirror_surfels(Surfels surfels);

/// Completes a symmetric object. Surfels of an unobserved patch are replaced by mirrored
/// surfels of the other side, if the other side was observed. The new surfels are
/// appended. Does nothing if both sides were observed and differ by more than 0.15 m.
/// @return number of surfels that were added
std::size_t mirror_unobserved(Surfels& surfels, ObservedBoxSurface& surface);

}  // namespace relidar
