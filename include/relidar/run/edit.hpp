// SPDX-License-Identifier: Apache-2.0
// Edits of a dynamic scene: pure functions from a scene with its tracks to another one. A
// track is where an instance stands at a time (Eq. 4-5), so an edit changes tracks and
// instances, and never a surfel.
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

/// Where a placed actor is at the start of the log, and how fast it drives straight ahead
/// (box frame x) from then on, m/s.
struct Start {
    Pose dataset_from_box;  ///< box centre in the dataset's world (relidar's world + world_offset_m)
    double speed_mps = 0.0;
};

/// A place on the ground.
struct GroundPlace {
    glm::dvec2 dataset_m{0.0};  ///< [2] x, y of the box's centre in the dataset's world
    /// in the dataset's world; none: as the log's vehicle drove where it came nearest
    std::optional<double> yaw_rad = {};
    double speed_mps = 0.0;
    /// how far the bottom of the actor's box is above the ground; none: as
    /// ground_clearance() finds it, or 0
    std::optional<double> clearance_m = {};
};

/// A scene and its log that are looked at alone.
struct DrivingView {
    const Scene& scene;
    const Sequence& sequence;
};

/// How far the bottom of an actor's box is above the ground below it, metres, in the
/// middle of its track: boxes of many labels begin above the road. @return nothing where
/// its own scene has no ground below it @throws UsageError as start_on_ground()
std::optional<double> ground_clearance(const DrivingView& owner, const std::string& track);

/// Where an actor stands on the background's surface: tilted as the plane of the level
/// surfels below its box is, and as high above that plane as it was above the ground
/// where its own scene has it, since boxes of many labels begin above the road (without
/// ground there: the box's bottom lies on the plane). Surfels above the log's sensor, and
/// a quarter of the distance to it more, are no ground: bridges, trees.
/// @param owner  the scene that has the actor @throws UsageError naming the place, where
/// the background has no level surface below it
Start start_on_ground(const DrivingView& driving, const GroundPlace& place, const DrivingView& owner,
                      const std::string& track);

/// Takes an actor and its track out. Rays continue to what the scene holds behind it.
/// @throws UsageError, here as in every function that takes a track, where no instance
/// has that track; the nearest name is told
DrivingScene remove_track(DrivingScene driving, const std::string& track);

/// Moves an actor in the frame its box has at each time, x forward, y left, z up, about
/// the box's own centre:
///   world_from_box'(t) = world_from_box(t) * box_from_moved
DrivingScene move_track(DrivingScene driving, const std::string& track, const Pose& box_from_moved);

/// Lets everything an actor does happen so many seconds later (earlier where negative);
/// it is absent outside its own interval.
DrivingScene retime_track(DrivingScene driving, const std::string& track, double seconds);

/// A line for the user that says in how many frames of the log an actor is absent after
/// an edit, but was present before it. Empty if there are none, or if the edited log has
/// no such track.
std::string lost_frames_note(const BoxTrack& before, const Sequence& edited);

/// Gives an actor another trajectory, interpolated between its entries (position
/// linearly, rotation by slerp) and absent outside.
/// @param dataset_from_box [>= 2] box centre in the dataset's world, at times of the log
/// (Frame::time_s)
/// @throws DataError for fewer than two entries, times that do not rise, or values that
/// are not finite
DrivingScene replace_trajectory(DrivingScene driving, const std::string& track,
                                const PoseTrack& dataset_from_box);

/// Places the model of an actor once more, as the last instance, under a new name: "0"
/// becomes "0-copy-1".
DrivingScene copy_track(DrivingScene driving, const std::string& track, const Start& start);

/// Places an actor of another scene, as the last instance. It keeps its name where that
/// is free, else "0" becomes "0-insert-1". Its harmonics are evaluated to the degree of
/// the scene it comes into; its intensities stay those of the sensor that saw it.
DrivingScene insert_track(DrivingScene driving, const DrivingScene& other, const std::string& track,
                          const Start& start);

/// Leaves the background alone, or the actors alone: then the background stays as a model
/// without surfels.
DrivingScene keep_background(DrivingScene driving);
DrivingScene keep_actors(DrivingScene driving);

/// How finely an actor is modelled for where it comes nearest to a LiDAR of the log.
struct ActorDetail {
    double nearest_m = 0.0;  ///< from the LiDAR to the box's centre, of all frames in which both are there
    double time_s = 0.0;     ///< of that frame
    std::size_t rays = 0;    ///< of that sweep whose line meets the box
    std::size_t surfels = 0;

    /// Whether there are so few surfels for so many rays that it shows as blobs with
    /// holes between: it was learnt from farther away.
    bool is_sparse() const { return rays > 8 * surfels; }
};
/// @param lidar  in Sequence::lidars @return no rays where actor and LiDAR never meet, or
/// where nothing is known of the LiDAR's rays
ActorDetail actor_detail(const DrivingScene& driving, const std::string& track, int lidar = 0);

/// The same where an actor stands before some rays. @param origin, direction [n,3] of the
/// rays, sensor frame
/// @param box_from_sensor  as the box stands there @param size_m [3] of the box
ActorDetail actor_detail(std::span<const glm::vec3> origin, std::span<const glm::vec3> direction,
                         const Pose& box_from_sensor, const glm::dvec3& size_m, std::size_t surfels);

/// Reads a trajectory from CSV, R = Rz(yaw) Ry(pitch) Rx(roll). A header names the
/// columns in any order: time_s, x, y, z, yaw_deg or yaw_rad, and optionally pitch and
/// roll in either unit. Without a header the columns are time_s, x, y, z, yaw_deg[,
/// pitch_deg, roll_deg]. write_trajectory() in relidar/log/trajectory_csv.hpp writes such
/// a file.
/// @throws DataError naming line and column, also for an unknown column and for fewer
/// than two poses
PoseTrack read_trajectory(const std::filesystem::path& path);

/// An entity of an OpenSCENARIO, and the trajectory that it follows.
struct ScenarioEntity {
    std::string name;
    /// its reference point, at seconds of the scenario; empty where it follows no
    /// trajectory
    PoseTrack world_from_reference;
    /// [3] of its bounding box, from the reference point: x forward, y left, z up
    glm::dvec3 centre_m{0.0};
    glm::dvec3 size_m{0.0};            ///< [3] length, width, height of that box
    std::vector<std::string> ignored;  ///< its other actions, by the names of their elements
};

/// The entities of an OpenSCENARIO XML 1.x with what they follow: FollowTrajectoryActions
/// of Init or of a Story's events, along polylines of WorldPositions at times of the
/// simulation (Timing absolute, or relative to an event that a SimulationTimeCondition
/// starts), one an entity; "$name" for parameters of the scenario. Missing z, h, p, r are
/// 0; R = Rz(h) Ry(p) Rx(r).
/// @throws DataError naming entity and element where a trajectory is anything else, and
/// for an entity with one and without a BoundingBox
std::vector<ScenarioEntity> read_scenario(const std::filesystem::path& path);

/// The way of an actor that stands for an entity: the middles of their boxes lie above
/// each other, and both stand on the same ground.
/// @param begin_s  when the scenario begins @param size_m [3] of the actor's box
PoseTrack box_track(const ScenarioEntity& entity, double begin_s, const glm::dvec3& size_m);

}  // namespace relidar
