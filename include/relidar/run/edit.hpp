// SPDX-License-Identifier: Apache-2.0
// Edits of a dynamic scene change only tracks (pose of an instance over time; paper, Eq.
// 4-5) and instances. Run::set_driving_scene() then completes the vehicles
// whose tracks have changed.
#pragma once

#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/log/log.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

/// The actor moves at constant speed along x of its initial box frame, or along a path.
struct NewActorMotion {
    /// Pose of the box centre at the start of the log. The dataset's world frame is
    /// relidar's world frame, shifted by world_offset_m.
    Pose dataset_from_box;
    double speed_mps = 0.0;
    /// Poses of the box centre, in the dataset's world frame. If the path is empty, the
    /// actor moves straight ahead.
    PoseTrack dataset_path = {};
    /// Total length, metres, of path sections whose ground the log has not observed.
    /// There, the height of the actor is interpolated, or follows the mean slope of its
    /// path.
    double unseen_m = 0.0;
};

struct GroundPlacement {
    glm::dvec2 dataset_m{0.0};  ///< x, y of the box centre in the dataset's world frame, [2] metres.
    /// Heading in the dataset's world frame, radians. Default: heading of the log's
    /// vehicle at the nearest point of its trajectory.
    std::optional<double> yaw_rad = {};
    double speed_mps = 0.0;
    /// Height of the box bottom above the ground, metres. Default: the height of the
    /// actor in its original scene, or 0 if that height is unknown.
    std::optional<double> clearance_m = {};
};

struct SceneWithLogView {
    const Scene& scene;
    const Log& log;
};

/// Returns the height of the bottom of an actor's box above the ground in metres: the
/// median along the track. Many labelled boxes begin above the road, so a copy must be
/// placed at the same height.
/// @return nullopt if the actor's scene has no ground below the box
/// @throws UsageError if no instance has this track
std::optional<double> ground_clearance(const SceneWithLogView& actor_scene, const std::string& track);

/// Places an actor on the ground of the background: the plane that is fitted to the level
/// surfels below the box. The actor is as high above it as in `actor_scene`, or on the
/// plane if that scene has no ground below the box. A moving actor gets a path that is
/// straight in x and y and follows the ground, as follow_ground() describes.
/// @param target_scene scene in which the actor is placed
/// @param actor_scene scene that contains the actor with the track `actor_track`
/// @throws UsageError naming the position if the background has no level surface below
/// the start
NewActorMotion stand_on_ground(const SceneWithLogView& target_scene, const GroundPlacement& placement,
                               const SceneWithLogView& actor_scene, const std::string& actor_track);

/// Puts a path on the ground. The ground is continuous: it is searched from the log's
/// vehicle to the start of the path and along the path, at most 0.25 m from where the
/// ground before leads. Labelled objects that stand still are not ground, and neither are
/// bridges and trees, which are above the log's sensor by more than a quarter of their
/// distance. Hidden ground is interpolated.
/// @param dataset_path  position (x, y) and heading of the box; z, pitch and roll are
/// ignored
/// @param clearance_m  as in GroundPlacement
/// @return the poses of the box centre, with the times of `dataset_path` and between them
/// @throws UsageError if no ground is observed below the start
NewActorMotion follow_ground(const SceneWithLogView& target_scene, const PoseTrack& dataset_path,
                             std::optional<double> clearance_m, const SceneWithLogView& actor_scene,
                             const std::string& actor_track);

/// Returns the height of the bottom of a box above the ground, metres, at each pose of
/// its centre. Finds the ground as follow_ground() does. No value where it was not
/// observed.
/// @param size_m [3] length, width and height of the box
std::vector<std::optional<double>> heights_above_ground(const SceneWithLogView& scene,
                                                        const PoseTrack& dataset_path,
                                                        const glm::dvec3& size_m);

/// Returns the tracks of all actors that edits have added or moved.
/// @param boxes_before boxes of the log before all edits
std::vector<std::string> list_changed_tracks(const SceneWithLogView& edited,
                                             const std::vector<BoxTrack>& boxes_before);

/// Checks actors that an edit has placed, at the times of the frames. Note ids:
/// "floating": the box is more than 0.3 m above the ground.
/// "overlap": the box and another box share more than 0.1 m.
/// "background": surfaces of the background at least 0.3 m above the ground, and the
/// space below them, fill more than 2 % of the box without 0.1 m at its sides.
/// @param tracks  the actors to check
Notes check_placement(const SceneWithLogView& edited, const std::vector<std::string>& tracks);

/// A labelled object that stood still in the background and is now an actor.
struct ReleasedObject {
    SceneWithLog edited;
    /// Ground below the object that the log has not observed, square metres. Its height,
    /// intensity and drop probability are those of the ground around it.
    double filled_m2 = 0.0;
    bool has_ground = true;  ///< false: the log has no ground around the object, so nothing is filled
};
/// Makes an actor of a labelled object that stands still: cuts its surfels out of the
/// background into a model, and closes the ground below it. Its box gets one pose for the
/// full log. Changes nothing if the track is not such an object. All edits of a track
/// call this function first. A scene without surfels only gets the track.
/// @throws UsageError if the background has no surfels in the box
ReleasedObject release_standing(SceneWithLog scene_and_log, const std::string& track);
/// Describes in one line which parts of a released object and of the ground below it the
/// log did not observe.
std::string describe_release(const ReleasedObject& released, const std::string& track);
/// Returns the box of a labelled object that stands still in the background, with one
/// pose for the full log. Returns nothing for an actor or an unknown track.
std::optional<BoxTrack> find_standing(const SceneWithLogView& scene_and_log, const std::string& track);

/// Removes an actor, so that rays hit the surfaces behind it.
/// @throws UsageError if no instance has this track, like all functions below with a
/// parameter `track`
SceneWithLog remove_track(SceneWithLog scene_and_log, const std::string& track);

/// Moves an actor by a constant offset relative to its box (x forward, y left, z up,
/// origin at the box centre):
///
///   world_from_box'(t) = world_from_box(t) * old_from_new
SceneWithLog move_track(SceneWithLog edited, const std::string& track, const Pose& old_from_new);

/// Sets the class name of an actor or of a labelled standing object.
/// @throws UsageError if the log has no box with this track, or for an empty name
SceneWithLog classify_track(SceneWithLog edited, const std::string& track, const std::string& category);

/// Delays an actor's track by a number of seconds. With a negative value, the actor
/// appears earlier. The actor is absent outside the time interval of the shifted track.
SceneWithLog delay_track(SceneWithLog scene_and_log, const std::string& track, double delay_s);

/// Multiplies the speed of an actor. Its track begins at the same time.
/// @throws UsageError if the factor is not above 0
SceneWithLog scale_speed(SceneWithLog edited, const std::string& track, double factor);

/// Mirrors surfels to the unobserved sides of vehicles whose tracks have changed. An
/// actor that was moved there and back gets exactly its old track.
/// @param boxes_before boxes of the log before all edits
SceneWithLog complete_actors(SceneWithLog scene_and_log, const std::vector<BoxTrack>& boxes_before);

/// Returns a message with the number of frames in which an edit has made an actor absent.
/// Returns an empty string if there are none, or if the edited log has no such track.
std::string describe_absence(const BoxTrack& original_box, const Log& edited_log);

/// Replaces the trajectory of an actor. Between the poses, positions are interpolated
/// linearly and rotations by slerp. Before the first and after the last pose, the actor
/// is absent.
/// @param dataset_from_box [>= 2] poses of the box centre in the dataset's world frame,
/// with times in the time of the log (Frame::time_s)
/// @throws DataError for fewer than two poses, times that do not increase, or values that
/// are not finite
SceneWithLog replace_track(SceneWithLog edited, const std::string& track, const PoseTrack& dataset_from_box);

/// Adds a copy of an actor that uses the same model, at the end of the instance list. The
/// first copy of track "0" gets the name "0-copy-1".
SceneWithLog copy_track(SceneWithLog scene_and_log, const std::string& track, const NewActorMotion& start);

/// Adds an actor from another scene at the end of the instance list. If the scene already
/// has its track, for example "0", the new track is called "0-insert-1". Intensities stay
/// those of the sensor that recorded the actor. Rendering ignores spherical harmonics
/// above the degree of the new scene.
SceneWithLog insert_track(SceneWithLog scene_and_log, const SceneWithLog& source_scene,
                          const std::string& track, const NewActorMotion& start);

/// Removes all actors. remove_background() keeps the actors and leaves no surfels of the
/// background.
SceneWithLog remove_actors(SceneWithLog scene_and_log);
SceneWithLog remove_background(SceneWithLog scene_and_log);

/// Surfels of an actor's model, and rays that hit the actor in the sweep nearest to it.
struct ActorModelResolution {
    /// Between the LiDAR and the box centre, over all frames that have both, metres.
    double nearest_m = 0.0;
    double time_s = 0.0;   ///< Time of the frame with the smallest distance.
    std::size_t rays = 0;  ///< Number of rays that hit the box in the sweep with the smallest distance.
    std::size_t surfels = 0;

    /// Returns true if the actor has too few surfels per ray and looks like separate
    /// blobs, because it was recorded from a larger distance.
    bool is_too_coarse() const { return rays > 8 * surfels; }
};
/// Compares the resolution of an actor's model with one LiDAR of the log.
/// @param lidar index in Log::lidars
/// @return result with 0 rays if no ray of the LiDAR hits the actor, or if the rays of
/// the LiDAR are unknown
ActorModelResolution model_resolution(const SceneWithLog& edited, const std::string& track, int lidar = 0);

/// Compares the number of an actor's surfels with the number of given rays that hit its
/// box. All rays are fired from one pose of the sensor.
/// @param ray_origins, ray_directions [n,3] sensor frame
/// @param box_from_sensor pose of the sensor in the frame of the box
/// @param size_m [3] size of the box, metres
ActorModelResolution model_resolution(std::span<const glm::vec3> ray_origins,
                                      std::span<const glm::vec3> ray_directions, const Pose& box_from_sensor,
                                      const glm::dvec3& size_m, std::size_t n_surfels);

/// Describes the sides of an actor that the log has not observed. Completed sides are
/// mirror images. The remaining sides have no surfels, so rays pass through them. Returns
/// an empty string if all sides were observed, or if it is unknown.
std::string describe_unseen(const Scene& scene, const std::string& track);

/// Reads a trajectory from a CSV file. A header line names the columns in any order:
/// time_s, x, y, z, yaw_deg or yaw_rad, and optionally pitch and roll in either unit.
/// Instead of x, y and z, the columns latitude_deg, longitude_deg and height_m give a
/// place on the earth; yaw is then counterclockwise from east. Without a header, the
/// columns are time_s, x, y, z, yaw_deg[, pitch_deg, roll_deg]. The rotation is R =
/// Rz(yaw) Ry(pitch) Rx(roll).
/// @param georeference  Log::georeference
/// @throws DataError naming line and column if a value is invalid, a column is unknown,
/// or there are fewer than two poses
/// @throws UsageError for places on the earth without `georeference` or without PROJ
PoseTrack read_trajectory(const std::filesystem::path& path,
                          const std::optional<Georeference>& georeference = {});
/// Reads the trajectory of an actor as read_trajectory() does. If the column z has the
/// word `ground` in all lines, z is NaN: use follow_ground().
PoseTrack read_actor_path(const std::filesystem::path& path,
                          const std::optional<Georeference>& georeference = {});

/// Reads the place of a log on the earth from a JSON file: the georeference, or a
/// scene.json or sequence.json that has one. Or fits the path of the vehicle to the
/// positions of a CSV file, with the columns time_s, latitude_deg, longitude_deg and
/// height_m. Assumes that the antenna is at the origin of the vehicle.
GeoreferenceFit read_georeference(const std::filesystem::path& path, const Log& log);

}  // namespace relidar
