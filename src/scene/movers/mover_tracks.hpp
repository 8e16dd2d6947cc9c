// SPDX-License-Identifier: Apache-2.0
// Links the clusters of one object from frame to frame and across gaps. Private to scene.
#pragma once

#include <glm/glm.hpp>
#include <vector>

#include <relidar/scene/scene.hpp>

#include "scene/visibility.hpp"

namespace relidar {

inline constexpr int kNoLabel = -1;

/// Points of one moving object in one frame. If the object has a label, these are the
/// points inside its labelled box.
struct MoverCluster {
    double time_s = 0.0;               ///< mean firing time of its returns
    glm::dvec3 centre_m{0.0};          ///< mean position of its returns, world
    std::vector<glm::dvec3> points_m;  ///< positions of its returns, world
    int label = kNoLabel;              ///< index in Log::boxes, or kNoLabel

    void merge_cluster(const MoverCluster& other);
};
using ClustersByFrame = std::vector<std::vector<MoverCluster>>;  ///< [frames]

/// Finds the clusters of points on moving objects in the given frames (ascending). The
/// processes of the group share a long log.
/// @return [frames] clusters of each frame, identical in all processes
ClustersByFrame find_clusters(const Log& log, const std::vector<int>& frames, VisibilityChecker& view,
                              const Progress& progress, const ProcessGroup& group);

struct KinematicState {
    glm::dvec3 position_m, velocity_mps, acceleration_mps2;
    glm::dvec3 position_after(double seconds) const {
        return position_m + seconds * (velocity_mps + 0.5 * seconds * acceleration_mps2);
    }
};
using KinematicPath = std::vector<KinematicState>;

/// Fits a smooth path through the observed positions of a track at ascending times. The
/// path is a smoothing spline of the fifth degree that penalizes changes of the
/// acceleration (docs/method.md section 6). Positions far from it get a low weight.
KinematicPath smooth_path(const std::vector<double>& times_s, const std::vector<glm::dvec3>& positions_m);

/// Returns the heading in radians at each position of a path on the ground: the direction
/// from the point 1.5 m earlier on the path to the point 1.5 m later. An object that
/// stops therefore keeps its last heading.
std::vector<double> path_headings_rad(const std::vector<glm::dvec3>& path_m);

struct MoverObservation {
    double frame_time_s;
    glm::dvec3 sensor_m;  ///< position of the sensor, world
    MoverCluster cluster;
};
inline bool is_labelled(const MoverObservation& observation) { return observation.cluster.label != kNoLabel; }

/// All observations of one object, in the order of the frames. Includes observations
/// before and after the labels of the object.
struct MoverTrack {
    std::vector<MoverObservation> observations;
    int label = kNoLabel;  ///< index in Log::boxes, or kNoLabel

    const MoverCluster& last_cluster() const { return observations.back().cluster; }
    std::vector<double> times_s() const;
};
using MoverTracks = std::vector<MoverTrack>;

/// Links clusters of points in successive frames to tracks of objects. In each frame,
/// links the best matches first. A cluster matches an object if it is near the predicted
/// position of the object. In frames with a label for the object, the cluster must have
/// this label instead.
/// @param clusters [frames]
MoverTracks link_clusters(const ClustersByFrame& clusters, const std::vector<double>& t_s, const Log& log);

/// Returns true if a track has enough observations, moves far enough, and is straight.
bool is_moving_track(const MoverTrack& track);

/// Returns true if a track stays near the recording vehicle at a fixed position relative
/// to it. Such a track is a part of the vehicle.
bool is_ego_part(const MoverTrack& track, const PoseTrack& world_from_vehicle);

/// Merges tracks that are parts of one object into the longest of them.
void merge_tracks(MoverTracks& tracks);

/// Fits an upright box to the returns of a track, with one pose per frame and x along the
/// motion. The size is the largest visible extent over the track, because only the end
/// near the sensor is measured reliably in each frame.
BoxTrack fit_box(const MoverTrack& track);

/// Enlarges a box if only one side of its object was visible: away from the sensor, to
/// the typical size of a car, a truck or a cyclist. Stores this kind in the box.
void enlarge_box(BoxTrack& box, const MoverTrack& track);

/// Adds poses to a labelled box for the times when the object was observed without a
/// label. The nearest labels give the offset between the box and the visible points.
BoxTrack extend_in_time(const MoverTrack& track, const BoxTrack& label);

/// Returns the speeds of a box in m/s. Each speed is measured over at least half a second
/// before a pose. Returns an empty vector if the track is shorter than half a second.
std::vector<double> speeds_mps(const BoxTrack& box);

}  // namespace relidar
