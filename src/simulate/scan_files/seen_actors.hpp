// SPDX-License-Identifier: Apache-2.0
// Finds the boxes of the actors in a scan. Computes the time at which the sensor faces
// each box, and how much of each actor is visible in the scan.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include <relidar/simulate/scan_files.hpp>
#include "recorded_moment.hpp"

namespace relidar::scan_files {

/// An actor that is present during a scan.
struct ActorInScan {
    const BoxTrack* box;
    /// Pose of the box at a time of the log, in the world frame of the dataset.
    std::function<Pose(double)> world_from_box;
    /// Time at which the sensor points at the actor, in the time of the log.
    double faced_s;
    std::size_t n_points;  ///< number of first returns of the scan on the actor
    /// Number of rays that hit the actor first, divided by the number that would hit it
    /// if the scene contained only this actor. No value if no ray would hit the actor, or
    /// if ScanRenderer::enable_actor_visibility() was not called.
    std::optional<double> visible_share;
};

/// Returns the actors of the log that are present during a scan.
/// @param format output options, with the actors in `format.actors`; the result refers to
/// `format`, so `format` must live longer
std::vector<ActorInScan> find_actors_present_in_scan(const RenderedScan& scan,
                                                     const ScanOutputOptions& format);

/// Returns the pose of the sensor at time `time_s` of the log, in the world frame of the
/// dataset.
Pose interpolate_sensor_pose_in_scan(const RenderedScan& scan, double time_s);

/// Returns the velocity of an object, computed by central differences of its poses.
/// @param get_world_from_object returns the pose of the object at a given time
Velocity compute_object_velocity(const std::function<Pose(double)>& get_world_from_object, double time_s);

}  // namespace relidar::scan_files
