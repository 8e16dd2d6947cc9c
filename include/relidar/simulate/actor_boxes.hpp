// SPDX-License-Identifier: Apache-2.0
// Finds the boxes of the labelled objects in a scan, and how much of each object the scan
// shows.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <relidar/base/math.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>

namespace relidar {

/// Reason why the scan does not show a standing object at the place of its label.
enum class LabelNote {
    none,
    covered,      ///< The box of an actor overlaps the box of the object, usually after an edit.
    not_observed  ///< Rays pass through the box without a surface: the scene has no such object.
};
/// Returns an empty text, "covered" or "not_observed".
const char* name_of(LabelNote note);

/// Box of an actor or of a standing object, at the time at which the sensor faces it.
/// Only then the box of a moving actor matches its points.
struct ActorBox {
    std::string track;
    ObjectClass object_class{};
    std::string label;           ///< label_of() the object
    bool is_discovered = false;  ///< true for a moving object without a label
    bool is_static = false;      ///< true for a standing object that is part of the background
    LabelNote note = LabelNote::none;
    glm::dvec3 size_m{0.0};        ///< length, width and height
    double time_s = 0.0;           ///< time of the box, in the time of the log
    Pose dataset_from_box;         ///< pose of the centre of the box
    glm::dvec3 velocity_mps{0.0};  ///< in the world frame of the dataset
    /// First returns of the scan on the actor, or returns of the background that are
    /// is_on_object() of a standing object.
    std::size_t n_points = 0;
    /// Rays that hit the object first, divided by those that would hit it alone. See
    /// ActorVisibility.
    double visible_share = 0.0;
};

/// Returns the boxes of `format.actors` and `format.standing` that at least one ray would
/// hit if no other object hid them, and standing objects with a note.
/// @param scan  rendered after ScanRenderer::count_actor_rays()
std::vector<ActorBox> actor_boxes_of(const RenderedScan& scan, const ScanOutputOptions& format);

/// Sets the poses of `options.actors` to those of a ScanRequest. Removes the boxes
/// of other actors.
void move_actor_boxes(ScanOutputOptions& options, const ActorTracksByName& dataset_from_actor);

}  // namespace relidar
