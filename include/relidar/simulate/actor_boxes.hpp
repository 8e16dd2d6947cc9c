// SPDX-License-Identifier: Apache-2.0
// Finds the boxes of the actors in a scan, and how much of each actor the scan shows.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include <relidar/base/math.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>

namespace relidar {

/// Box of an actor at the time at which the sensor faces it; only then it matches the
/// points.
struct ActorBox {
    std::string track, category;
    glm::dvec3 size_m{0.0};        ///< length, width and height
    double time_s = 0.0;           ///< time of the box, in the time of the log
    Pose dataset_from_box;         ///< pose of the centre of the box
    glm::dvec3 velocity_mps{0.0};  ///< in the world frame of the dataset
    std::size_t n_points = 0;      ///< first returns of the scan on the actor
    /// rays that hit the actor first, divided by those that would hit it alone
    double visible_share = 0.0;
};

/// Returns the boxes of `format.actors` that at least one ray would hit if no other
/// object hid them.
/// @param scan  rendered after ScanRenderer::count_actor_rays()
std::vector<ActorBox> actor_boxes_of(const RenderedScan& scan, const ScanOutputOptions& format);

/// Sets the poses of `options.actors` to those of a ScanRequest. Removes the boxes
/// of other actors.
void move_actor_boxes(ScanOutputOptions& options, const ActorTracksByName& dataset_from_actor);

}  // namespace relidar
