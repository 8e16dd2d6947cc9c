// SPDX-License-Identifier: Apache-2.0
// Links the clusters of one object from frame to frame and across gaps. Private to scene.
#pragma once

#include "scene/movers/mover_clusters.hpp"

namespace relidar {

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

}  // namespace relidar
