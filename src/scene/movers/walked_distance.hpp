// SPDX-License-Identifier: Apache-2.0
// Measures how far an actor has walked (docs/method.md M14). Private to scene.
#pragma once

#include <relidar/scene/scene.hpp>

namespace relidar {

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
