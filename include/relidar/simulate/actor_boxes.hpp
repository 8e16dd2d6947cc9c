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

/// Box of an actor at the time at which the sensor faces the actor. The box of a moving
/// actor matches its points only at this time.
struct ActorBox {
    std::string track, category;
    glm::dvec3 size_m{0.0};        ///< length, width and height
    double time_s = 0.0;           ///< time of the box, in the time of the log
    Pose dataset_from_box;         ///< pose of the centre of the box
    glm::dvec3 velocity_mps{0.0};  ///< in the world frame of the dataset
    std::size_t n_points = 0;      ///< first returns of the scan on the actor
    /// Rays that hit the actor first, divided by the rays that would hit it if the scene
    /// contained only this actor.
    double visible_share = 0.0;
};

/// Returns the boxes of all actors in `format.actors` that at least one ray of the scan
/// would hit if no other object hid them.
/// @param scan  scan with actor_views. ScanRenderer::enable_actor_visibility() must have
/// been called before the scan was rendered
std::vector<ActorBox> find_actor_boxes(const RenderedScan& scan, const ScanOutputOptions& format);

/// Sets the poses in `output_options.actors`, the actor boxes that are written to
/// recordings, to the poses of a ScanRequest. Removes the boxes of actors that the
/// request does not contain.
void set_actor_boxes_to_requested_poses(ScanOutputOptions& output_options,
                                        const ActorTracksByName& dataset_from_actor);

}  // namespace relidar
