// SPDX-License-Identifier: Apache-2.0
// Makes surfels from points. Estimates their normals and scales from nearest neighbours
// (docs/method.md section 2). Used for the background and for actors. Private to scene.
#pragma once

#include <relidar/scene/scene.hpp>

namespace relidar {

/// A point of the log: position, intensity, and direction from the sensor. Coordinates
/// are in the world frame or in the frame of an actor's box.
struct LidarSample {
    glm::vec3 position;
    float intensity;
    glm::vec3 view;         ///< unit vector from the sensor to the point
    float walked_m = 0.0f;  ///< distance that the actor had walked
    int frame = 0;          ///< index in the log of the point's frame; used only for actors
};
using LidarSamples = std::vector<LidarSample>;
using SampleIndices = std::vector<std::uint32_t>;

/// Calls `work` with each return of a frame (as a WorldReturn), ray by ray.
/// @param second_returns if true, also calls `work` with second returns
template <class Work>
void for_each_return(const Log& log, const Frame& frame, bool second_returns, const Work& visit_return) {
    const Scan& scan = frame.scan;
    for (std::size_t ray = 0; ray < scan.range_m.size(); ++ray) {
        if (!(scan.range_m[ray] > 0.0f)) continue;
        visit_return(locate_return(log, frame, ray));
        for (std::size_t k = 0; second_returns && k < scan.second_returns.size(); ++k)
            if (scan.second_returns[k].range_m[ray] > 0.0f)
                // number 0 is the first return of the ray
                visit_return(locate_return(log, frame, ray, k + 1));
    }
}

/// Makes one surfel for each sample, in kd-tree order. If normals are estimated, the
/// initial intensity depends on the angle of incidence.
/// @param samples must not be empty
/// @param incidence strength of this dependence (IntensityResponse)
/// @param order output [n]: the index of each surfel's sample
Surfels make_surfels(const LidarSamples& samples, const InitOptions& options, double incidence,
                     const Progress& progress = {}, SampleIndices* order = nullptr);

/// Returns the first sample of each voxel of an actor, at most `max_count`. The samples
/// of a voxel are not averaged: labels jitter, so averages would shrink the actor.
/// @param selected output: indices of the returned samples
LidarSamples thin_samples(const LidarSamples& samples, std::size_t max_count,
                          SampleIndices* selected = nullptr);

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
/// @return no surfels with fewer than three frames, or if the actor walks less than 0.5 m
DeformingActorSurfels make_deforming(const LidarSamples& samples, const InitOptions& options,
                                     double incidence, std::size_t max_count, const Progress& progress = {});

/// Computes the distance that an actor has walked along its track. Averages positions
/// over one second, because labels jitter. Slower than 0.2 m/s counts as standing.
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
