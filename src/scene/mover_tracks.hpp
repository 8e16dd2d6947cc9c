// SPDX-License-Identifier: Apache-2.0
// Groups of returns of one thing, linked from frame to frame, and across gaps. Private to
// scene.
#pragma once

#include <vector>

#include <relidar/log/sequence.hpp>

#include "scene/mover_clusters.hpp"

namespace relidar {

/// What a frame saw of a thing.
struct Observation {
    double frame_time_s;
    glm::dvec3 sensor_m;  ///< where the sensor was, world
    MoverCluster cluster;
};

/// What was seen of one thing, frames ascending. Of what a label follows for a while,
/// those of the label are among them.
struct MoverTrack {
    std::vector<Observation> seen;
    int label = kNoLabel;  ///< position in Sequence::boxes

    const MoverCluster& last() const { return seen.back().cluster; }
    /// Mean times at which its returns were seen.
    std::vector<double> times() const;
};

/// Links clusters of ascending frames, the best fits of a frame first. What a label
/// follows is linked by the label while that is there, and like the rest before and
/// after.
/// @param clusters [frames]
std::vector<MoverTrack> link_clusters(const std::vector<std::vector<MoverCluster>>& clusters,
                                      const std::vector<double>& frame_times_s, const Sequence& sequence);

/// Whether a track comes far enough, fairly straight, in enough frames.
bool comes_far(const MoverTrack& track);

/// Whether it stays where it is as seen from the sensor, close by: a part of the vehicle
/// that carries the sensor.
bool rides_along(const MoverTrack& track, const PoseTrack& world_from_vehicle);

/// Gives the returns of parts to the track of which they are parts.
void join_parts(std::vector<MoverTrack>& tracks);

}  // namespace relidar
