// SPDX-License-Identifier: Apache-2.0
// Measures the walked distance and the stride of people and cyclists, and makes surfels
// that move with the stride (docs/method.md M14). Private to scene.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/scene/scene.hpp>

#include "scene/point_surfels.hpp"

namespace relidar {

/// Distance that an actor has walked along its track. Averages the positions over one
/// second, because labels jitter. Motion slower than 0.2 m/s counts as standing.
class WalkedWay {
public:
    explicit WalkedWay(const PoseTrack& world_from_box);
    /// Returns the distance walked since the first pose, in metres. Extrapolates outside
    /// the track with the speed at its end.
    double at(double t_s) const;

private:
    std::vector<double> time_s_, walked_m_;
};

/// Range of distances that one turn of a gait may cover.
struct StrideRange {
    double least_m, most_m;
};
/// Returns the range of strides of a kind of object that bends, or nothing for a rigid
/// kind.
std::optional<StrideRange> stride_range(ObjectKind kind);

/// Estimated stride, or the reason why there is none.
struct FoundStride {
    double stride_m = 0.0;  ///< 0 if no stride was found
    std::string why_none = {};
};
/// Finds the stride for which points of the same phase in different turns are nearest to
/// each other.
/// @param samples points in the frame of the box, with the distance walked so far
FoundStride find_stride(const std::vector<Sample>& samples, const StrideRange& range);

/// Makes the surfels of a walking actor. Points that are present at every phase become
/// surfels at rest. Other points become surfels that are visible around their own phase
/// and swing with the velocity of their neighbours.
/// @param samples at least one
/// @param most maximum number of surfels
/// @param progress an exception that it throws ends the call
Surfels surfels_that_walk(const std::vector<Sample>& samples, double stride_m,
                          const InitialiseOptions& options, double incidence, std::size_t most,
                          const Progress& progress = {});

}  // namespace relidar
