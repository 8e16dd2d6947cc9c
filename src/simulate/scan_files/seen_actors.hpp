// SPDX-License-Identifier: Apache-2.0
// Finds the boxes of the actors and standing objects in a scan. Computes the time at
// which the sensor faces each box, and how much of each object is visible in the scan.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include <relidar/base/math.hpp>

namespace relidar {
enum class LabelNote;
struct BoxTrack;
struct RenderedScan;
struct ScanOutputOptions;
}  // namespace relidar

namespace relidar::scan_files {

/// The components are along the axes of the object.
struct Velocity {
    glm::dvec3 linear_mps{0.0}, angular_radps{0.0};
};

struct ActorInScan {
    const BoxTrack* box;
    /// in the world frame of the dataset
    std::function<Pose(double)> world_from_box;
    /// time of the log at which the sensor points at the actor
    double faced_s;
    std::size_t n_points;  ///< as ActorBox::n_points
    /// Rays that hit the actor first, divided by those that would hit it alone. No value
    /// if no ray would hit it, or without ScanRenderer::count_actor_rays().
    std::optional<double> visible_share;
    bool is_static = false;
    LabelNote note{};
};

/// Returns the actors of the log that are present during a scan, and the standing objects
/// within the range of the sensor.
/// @param format has the actors; must outlive the result
std::vector<ActorInScan> find_actors(const RenderedScan& scan, const ScanOutputOptions& format);

/// Returns the pose of the sensor at `time_s`, in the world frame of the dataset.
Pose sensor_pose_at(const RenderedScan& scan, double time_s);

/// Returns the velocity of an object by central differences of its poses.
Velocity object_velocity(const std::function<Pose(double)>& get_world_from_object, double time_s);

}  // namespace relidar::scan_files
