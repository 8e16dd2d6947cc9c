// SPDX-License-Identifier: Apache-2.0
// Edits of a dynamic scene: pure functions that return an edited copy of a scene and its
// tracks. A track gives the pose of an instance over time (Eq. 4-5). An edit therefore
// changes tracks and instances, and never the values of a surfel.
#pragma once

#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/sequence.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

/// Pose of a new actor at the start of the log, and its constant speed straight ahead
/// (box frame x), m/s.
struct Start {
    /// Pose of the box centre in the dataset's world frame (relidar's world +
    /// world_offset_m).
    Pose dataset_from_box;
    double speed_mps = 0.0;
};

/// Position and heading of an actor on the ground.
struct GroundPlace {
    glm::dvec2 dataset_m{0.0};  ///< x, y of the box centre in the dataset's world frame, [2] metres.
    /// Heading in the dataset's world frame, radians. Default: heading of the log's
    /// vehicle at the point of its trajectory nearest to this position.
    std::optional<double> yaw_rad = {};
    double speed_mps = 0.0;
    /// Height of the box bottom above the ground, metres. Default: result of
    /// ground_clearance(), or 0 if it has none.
    std::optional<double> clearance_m = {};
};

/// Read-only view of a scene and its log.
struct DrivingView {
    const Scene& scene;
    const Sequence& sequence;
};

/// Returns the median height of the bottom of an actor's box above the ground along its
/// track, metres. The height is needed because many labelled boxes begin above the road.
/// @return nullopt if the actor's scene has no ground below the box
/// @throws UsageError if no instance has this track
std::optional<double> ground_clearance(const DrivingView& owner, const std::string& track);

/// Computes the pose of an actor on the surface of the background. The actor is tilted
/// like the plane through the level surfels below its box. Its height above the plane is
/// its height above the ground in the scene that owns it, because many labelled boxes
/// begin above the road. If that scene has no ground below the box, the bottom of the box
/// is placed on the plane. Surfels higher than the log's sensor plus a quarter of the
/// distance to it are not ground, but bridges or trees.
/// @param owner scene that contains the actor
/// @throws UsageError naming the position if the background has no level surface below it
Start start_on_ground(const DrivingView& driving, const GroundPlace& place, const DrivingView& owner,
                      const std::string& track);

/// Removes an actor and its track. Rays then see the parts of the scene behind the actor.
/// This function and all functions below that have a parameter `track` throw the same
/// error.
/// @throws UsageError if no instance has this track; the message suggests the most
/// similar name
DrivingScene remove_track(DrivingScene driving, const std::string& track);

/// Moves an actor relative to its box frame at each time (x forward, y left, z up, origin
/// at the box centre):
///
///   world_from_box'(t) = world_from_box(t) * box_from_moved
DrivingScene move_track(DrivingScene driving, const std::string& track, const Pose& box_from_moved);

/// Delays an actor's track by a number of seconds; negative values advance it. The actor
/// is absent outside the time interval of its track.
DrivingScene retime_track(DrivingScene driving, const std::string& track, double seconds);

/// Returns a note with the number of frames in which an actor is absent after an edit but
/// was present before it. Returns an empty string if there are none, or if the edited log
/// has no such track.
std::string lost_frames_note(const BoxTrack& before, const Sequence& edited);

/// Replaces the trajectory of an actor. Poses are interpolated between the entries
/// (position linearly, rotation by slerp). The actor is absent outside the trajectory.
/// @param dataset_from_box [>= 2] poses of the box centre in the dataset's world frame,
/// at times of the log (Frame::time_s)
/// @throws DataError for fewer than two entries, times that do not increase, or values
/// that are not finite
DrivingScene replace_trajectory(DrivingScene driving, const std::string& track,
                                const PoseTrack& dataset_from_box);

/// Adds a second instance of an actor's model, as the last instance, with a new name: "0"
/// becomes "0-copy-1".
DrivingScene copy_track(DrivingScene driving, const std::string& track, const Start& start);

/// Adds an actor of another scene, as the last instance. It keeps its name if that name
/// is free; otherwise "0" becomes "0-insert-1". Its harmonics are evaluated to the SH
/// degree of the scene that it is inserted into. Its intensities remain those of the
/// sensor that recorded it.
DrivingScene insert_track(DrivingScene driving, const DrivingScene& other, const std::string& track,
                          const Start& start);

/// Removes all actors, or removes all background surfels. keep_actors() keeps the
/// background as a model without surfels.
DrivingScene keep_background(DrivingScene driving);
DrivingScene keep_actors(DrivingScene driving);

/// Resolution of an actor's model, compared with the rays of a LiDAR where the actor is
/// nearest to that LiDAR.
struct ActorDetail {
    /// Smallest distance from the LiDAR to the box centre over all frames in which both
    /// are present, metres.
    double nearest_m = 0.0;
    double time_s = 0.0;   ///< Time of the frame with the smallest distance.
    std::size_t rays = 0;  ///< Number of rays of that sweep that hit the box.
    std::size_t surfels = 0;

    /// Returns true if there are so few surfels per ray that the actor appears as blobs
    /// with gaps between them. Such an actor was trained from a larger distance.
    bool is_sparse() const { return rays > 8 * surfels; }
};
/// Computes the resolution of an actor of the scene for one LiDAR.
/// @param lidar index in Sequence::lidars
/// @return 0 rays if the LiDAR never sees the actor, or if the rays of the LiDAR are
/// unknown
ActorDetail actor_detail(const DrivingScene& driving, const std::string& track, int lidar = 0);

/// Computes the resolution of an actor at one pose in front of given rays.
/// @param origin [n,3] origins of the rays, sensor frame
/// @param direction [n,3] directions of the rays, sensor frame
/// @param box_from_sensor pose of the sensor in the frame of the box
/// @param size_m [3] size of the box, metres
ActorDetail actor_detail(std::span<const glm::vec3> origin, std::span<const glm::vec3> direction,
                         const Pose& box_from_sensor, const glm::dvec3& size_m, std::size_t surfels);

/// Reads a trajectory from a CSV file, with R = Rz(yaw) Ry(pitch) Rx(roll). A header
/// names the columns in any order: time_s, x, y, z, yaw_deg or yaw_rad, and optionally
/// pitch and roll in either unit. Without a header the columns are time_s, x, y, z,
/// yaw_deg[, pitch_deg, roll_deg]. write_trajectory() in relidar/log/trajectory_csv.hpp
/// writes such a file.
/// @throws DataError naming line and column if a value is invalid, a column is unknown,
/// or there are fewer than two poses
PoseTrack read_trajectory(const std::filesystem::path& path);

/// Entity of an OpenSCENARIO file and the trajectory that it follows.
struct ScenarioEntity {
    std::string name;
    /// Poses of the entity's reference point, at times of the scenario in seconds. Empty
    /// if the entity follows no trajectory.
    PoseTrack world_from_reference;
    /// Centre of the bounding box relative to the reference point, [3] metres: x forward,
    /// y left, z up.
    glm::dvec3 centre_m{0.0};
    glm::dvec3 size_m{0.0};  ///< Length, width and height of the bounding box, [3] metres.
    /// XML element names of the entity's other actions, which relidar ignores.
    std::vector<std::string> ignored;
};

/// Reads the entities of an OpenSCENARIO XML 1.x file and their trajectories. Supports
/// one FollowTrajectoryAction per entity, in Init or in an event of a Story. The
/// trajectory must be a polyline of WorldPositions with times. Timing is absolute, or
/// relative to an event that a SimulationTimeCondition starts. "$name" refers to
/// parameters of the scenario. Missing z, h, p, r are 0; R = Rz(h) Ry(p) Rx(r).
/// @throws DataError naming entity and element if a trajectory has any other form, or if
/// an entity with a trajectory has no BoundingBox
std::vector<ScenarioEntity> read_scenario(const std::filesystem::path& path);

/// Returns the track of an actor that replaces a scenario entity. The box centres have
/// the same x and y, and both boxes stand on the same ground.
/// @param begin_s time of the log at which the scenario begins
/// @param size_m [3] size of the actor's box, metres
PoseTrack box_track(const ScenarioEntity& entity, double begin_s, const glm::dvec3& size_m);

}  // namespace relidar
