// SPDX-License-Identifier: Apache-2.0
// Makes surfels of people and cyclists whose shape changes from frame to frame
// (docs/method.md M14). Private to scene.
#pragma once

#include <relidar/scene/scene.hpp>

#include "scene/point_surfels.hpp"

namespace relidar {

struct DeformingActorSurfels {
    Surfels surfels;
    double period_m = 0.0;       ///< Walked distance after which the motion repeats.
    std::string why_rigid = {};  ///< reason why the actor has no such surfels; empty if it has some
};
/// Makes surfels that are visible only around the time of their frame and move like the
/// points of the neighbouring frames. At positions where most frames have a point, the
/// surfels are always visible and do not move.
/// @param samples  points in the frame of the box, with the distance that the actor
/// walked
/// @param max_count  maximum number of surfels; each frame may still have 200 surfels
/// @return no surfels and period 0 with fewer than three frames, or if the actor walks
/// less than half a metre
DeformingActorSurfels make_deforming(const LidarSamples& samples, const InitOptions& options,
                                     double incidence, std::size_t max_count, const Progress& progress = {});

/// Computes the distance that an actor has walked along its track. Averages the positions
/// over one second, because labelled positions jitter. Motion slower than 0.2 m/s counts
/// as standing.
class WalkedDistanceTrack {
public:
    explicit WalkedDistanceTrack(const PoseTrack& world_from_box);
    /// Returns the distance walked since the first pose, in metres. Before and after the
    /// track, extrapolates with the speed at that end of the track.
    double walked_m(double t_s) const;

private:
    std::vector<double> time_s_, walked_m_;
};

}  // namespace relidar
