// SPDX-License-Identifier: Apache-2.0
// Measures how far people and cyclists have walked, and estimates the length of their
// stride. Makes surfels that move periodically with the stride (docs/method.md M14).
// Private to scene.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include <relidar/scene/scene.hpp>

#include "scene/point_surfels.hpp"

namespace relidar {

/// Computes the distance that an actor has walked along its track. Averages the positions
/// over one second, because labelled positions jitter. Motion slower than 0.2 m/s counts
/// as standing.
class WalkedDistance {
public:
    explicit WalkedDistance(const PoseTrack& world_from_box);
    /// Returns the distance walked since the first pose, in metres. Before and after the
    /// track, extrapolates with the speed at that end of the track.
    double at(double t_s) const;

private:
    std::vector<double> time_s_, walked_m_;
};

/// Minimum and maximum length of a stride, in metres.
struct StrideRange {
    double least_m, most_m;
};
/// Returns the possible stride lengths of people or cyclists. Returns nothing for rigid
/// objects.
std::optional<StrideRange> get_stride_range(ObjectKind kind);

/// Stride of an actor, or the reason why no stride was found.
struct StrideEstimate {
    double stride_m = 0.0;  ///< 0 if no stride was found
    std::string why_none = {};
};
/// Finds the stride length of an actor. For each tried length, compares the points that
/// different strides have at the same phase. Chooses the length for which these points
/// are nearest to each other.
/// @param samples points in the frame of the box, with the distance that the actor has
/// walked so far
StrideEstimate find_stride(const std::vector<Sample>& samples, const StrideRange& range);

/// Makes the surfels of a walking actor. Points that are present at every phase of the
/// stride become static surfels. Every other point becomes a surfel that is visible only
/// around the phase of the point. Such a surfel moves with the velocity of the points
/// nearby.
/// @param samples must not be empty
/// @param max_count maximum number of surfels
/// @param progress called during the work; if it throws an exception, the function stops
Surfels make_walking_surfels(const std::vector<Sample>& samples, double stride_m,
                             const InitialiseOptions& options, double incidence, std::size_t max_count,
                             const Progress& progress = {});

}  // namespace relidar
