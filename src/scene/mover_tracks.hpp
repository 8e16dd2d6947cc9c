// SPDX-License-Identifier: Apache-2.0
// Links the clusters of one object from frame to frame and across gaps. Private to scene.
#pragma once

#include <vector>

#include <relidar/log/sequence.hpp>

#include "scene/mover_clusters.hpp"

namespace relidar {

/// Observation of an object in one frame.
struct Observation {
    double frame_time_s;
    glm::dvec3 sensor_m;  ///< position of the sensor, world
    MoverCluster cluster;
};

/// All observations of one object in the order of the frames. If the object is labelled
/// for a while, the observations with the label are included.
struct MoverTrack {
    std::vector<Observation> seen;
    int label = kNoLabel;  ///< index in Sequence::boxes, or kNoLabel

    const MoverCluster& last() const { return seen.back().cluster; }
    /// Returns the mean firing time of each observation's returns.
    std::vector<double> times() const;
};

/// Links the clusters of ascending frames, the best matches of a frame first. While an
/// object has a label, its clusters are linked by the label. Before and after, they are
/// linked like the clusters of other objects.
/// @param clusters [frames]
std::vector<MoverTrack> link_clusters(const std::vector<std::vector<MoverCluster>>& clusters,
                                      const std::vector<double>& frame_times_s, const Sequence& sequence);

/// Returns true if a track moves far enough, fairly straight, and in enough frames.
bool comes_far(const MoverTrack& track);

/// Returns true if a track keeps its position relative to the vehicle and is close to it.
/// Such a track is a part of the recording vehicle.
bool rides_along(const MoverTrack& track, const PoseTrack& world_from_vehicle);

/// Adds the returns of tracks that are parts of an object to the main track of that
/// object.
void join_parts(std::vector<MoverTrack>& tracks);

}  // namespace relidar
